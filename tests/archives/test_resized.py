"""A camera whose picture is resized on some day: two states of one camera, each with its own size."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.archives.made import analysed, indexed_in

from sunarc.formats.calibration_document import from_document
from sunarc.lab.simulation.made_archive import FOUR_CAMERAS, MadeArchive, camera_at
from sunarc.optics.forward import project

MADE = MadeArchive(cameras=FOUR_CAMERAS[3:], days=6, per_day=14, cloudy_share=0.0, broken=0)
SMALL = 192


def test_a_resized_picture_is_an_epoch_of_its_camera(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    indexed_in(tmp_path, MADE)
    for path in sorted((tmp_path / "hut").iterdir())[3 * 14 :]:
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert image is not None
        cv2.imwrite(str(path), cv2.resize(image, (SMALL, SMALL), interpolation=cv2.INTER_AREA))
    summary, _ = analysed(indexed_in(tmp_path, MADE), tmp_path / "out", monkeypatch)
    assert summary is not None
    epochs = json.loads((tmp_path / "out" / "epochs.json").read_text())
    assert [(one["camera"], one["epoch"], one["cause"]) for one in epochs] == [
        ("hut", "001", "start"), ("hut", "002", "resized"),
    ]  # fmt: skip
    assert epochs[0]["end"] < epochs[1]["start"]
    first, second = (from_document(summary.documents["hut", one]).camera for one in ("001", "002"))
    assert [(one.width, one.height) for one in (first, second)] == [(MADE.size, MADE.size), (SMALL, SMALL)]
    assert second.focal_length_px[0] / first.focal_length_px[0] == pytest.approx(SMALL / MADE.size, rel=0.02)
    table = (tmp_path / "out" / "sightings.csv").read_text()
    assert {line.split(",")[-1] for line in table.splitlines()[1:]} == {"001", "002"}
    assert {line.split(",")[0] for line in table.splitlines()[1:]} == {"hut"}
    assert {path.name for path in (tmp_path / "out").glob("horizon_*")} == {
        "horizon_hut.png", "horizon_hut-192x192.png"
    }  # fmt: skip


def test_a_camera_hung_upside_down_is_another_state_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    indexed_in(tmp_path, MADE)
    for path in sorted((tmp_path / "hut").iterdir())[3 * 14 :]:
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert image is not None
        cv2.imwrite(str(path), cv2.rotate(image, cv2.ROTATE_180))
    summary, _ = analysed(indexed_in(tmp_path, MADE), tmp_path / "out", monkeypatch)
    assert summary is not None
    (camera,) = summary.report["cameras"]
    assert [(one["cause"], one["accepted"]) for one in camera["epochs"]] == [("start", True), ("moved", True)]
    true = camera_at(MADE, MADE.cameras[0], MADE.first_day.timestamp())
    zenith, azimuth = np.radians(np.repeat([5.0, 35.0, 65.0], 8)), np.radians(np.tile(np.arange(0.0, 360.0, 45.0), 3))
    sky = np.stack([np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)], axis=-1)
    for name in ("001", "002"):
        found = from_document(summary.documents["hut", name])
        pixels = project(found.camera, sky)
        pixels = MADE.size - 1.0 - pixels if name == "002" else pixels
        apart_px = np.sqrt(np.mean(np.sum((pixels - project(true, sky)) ** 2, axis=-1)) / 2.0)
        assert np.degrees(apart_px / true.focal_length_px[0]) < 2.0 * found.sky_rms_deg
