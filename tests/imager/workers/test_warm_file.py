"""The list of warm pixels over a restart: of its sensor alone, and whatever becomes of its file no night is lost."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.imager.workers.test_full_disk import mounted
from tests.imager.workers.test_night import BEGIN, CAMERA, Bench, bench
from tests.imager.workers.test_warm_pixels import MINUTES

from sunarc.common.findings import Finding
from sunarc.detection.stars.warm_pixels import SensorFormat, WarmPixelMap
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.workers.night.images import WarmPixelFile

__all__ = ["bench"]

SENSOR = SensorFormat(60, 80, "Mono12", 1, "SIM-1")
PIXELS = np.array([0, 7, 4799])


class Kept:
    """A file of warm pixels, and what was reported of it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.found: list[Finding] = []
        self.file = WarmPixelFile(path, self.found.append)

    @property
    def codes(self) -> list[str]:
        return [one.code for one in self.found]


@pytest.fixture
def kept(tmp_path: Path) -> Kept:
    return Kept(tmp_path / "warm-pixels.json")


def test_a_list_comes_back_as_it_was(kept: Kept) -> None:
    assert kept.file.read(SENSOR).size == 0  # the first start of a camera
    kept.file.write(SENSOR, PIXELS)
    assert kept.file.read(SENSOR).tolist() == PIXELS.tolist()
    kept.file.write(SENSOR, PIXELS[:1])
    assert kept.file.read(SENSOR).tolist() == [0]
    assert (kept.codes, [path.name for path in kept.path.parent.iterdir()]) == ([], ["warm-pixels.json"])


@pytest.mark.parametrize(
    "other", [{"rows": 59}, {"columns": 81}, {"pixel_format": "Mono8"}, {"binning": 2}, {"serial": "SIM-2"}]
)
def test_a_list_of_another_sensor_is_not_used(kept: Kept, other: dict[str, Any]) -> None:
    kept.file.write(SENSOR, PIXELS)
    assert kept.file.read(SENSOR._replace(**other)).size == 0
    assert kept.codes == ["warm_pixels_other_sensor"]
    assert kept.found[0].data["stored"] != kept.found[0].data["present"]


def changed(**fields: Any) -> Callable[[bytes], bytes]:  # noqa: ANN401 - of JSON
    return lambda content: json.dumps({**json.loads(content), **fields}).encode()


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content[:-9],
        lambda _: b"",
        lambda _: b"[]",
        lambda _: b"[" * 100_000,
        lambda content: content.replace(b"7", b"\xff"),
        lambda content: content + b" " * (1 << 20),
        changed(version=2),
        changed(pixels=None),
        changed(pixels=[0, 4800]),
        changed(pixels=[-1, 3]),
        changed(pixels=[7, 7]),
        changed(pixels=[7.0]),
        changed(pixels=[True]),
        changed(pixels=[2**80]),
        changed(pixels=list(range(40_001))),
        changed(sensor={"rows": 60}),
        changed(sensor={**SENSOR._asdict(), "rows": "60"}),
    ],
)
def test_a_damaged_file_is_reported_and_written_anew(kept: Kept, damage: Callable[[bytes], bytes]) -> None:
    kept.file.write(SENSOR, PIXELS)
    kept.path.write_bytes(damage(kept.path.read_bytes()))
    assert kept.file.read(SENSOR).size == 0
    assert kept.codes == ["warm_pixels_unread"]
    kept.file.write(SENSOR, PIXELS)
    assert kept.file.read(SENSOR).tolist() == PIXELS.tolist()


def test_a_folder_in_its_place_is_reported_on_reading_and_writing(kept: Kept, caplog: pytest.LogCaptureFixture) -> None:
    kept.path.mkdir()
    assert kept.file.read(SENSOR).size == 0
    assert kept.codes == ["warm_pixels_unread"]
    kept.file.write(SENSOR, PIXELS)
    assert [getattr(record, "event_kind", "") for record in caplog.records] == ["warm_pixels_unwritten"]
    assert [path.name for path in kept.path.parent.iterdir()] == ["warm-pixels.json"]


def test_a_list_is_no_larger_than_what_is_read(kept: Kept) -> None:
    large = SENSOR._replace(rows=100_000, columns=100_000)
    kept.file.write(large, np.arange(10**10 - 50_000, 10**10))
    assert kept.path.stat().st_size < 1 << 20
    assert kept.file.read(large).size == 40_000


def test_a_full_disk_leaves_the_former_list(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    if os.geteuid() != 0:
        pytest.skip("mounting a small disk needs root")
    with mounted(tmp_path, "size=64k"):
        kept = Kept(tmp_path / "warm-pixels.json")
        kept.file.write(SENSOR, PIXELS)
        with caplog.at_level(logging.WARNING):
            kept.file.write(SENSOR._replace(rows=1000), np.arange(40_000))
        assert [getattr(record, "event_kind", "") for record in caplog.records] == ["warm_pixels_unwritten"]
        assert kept.file.read(SENSOR).tolist() == PIXELS.tolist()
        assert [path.name for path in tmp_path.iterdir()] == ["warm-pixels.json"]


def noise_at(minutes: int) -> Frame:
    """Return an image of noise with 300 warm pixels; every thirtieth is one."""
    rng = np.random.default_rng(minutes)
    counts = rng.poisson(200.0, (CAMERA.height, CAMERA.width)).astype(np.uint16)
    counts.ravel()[:9000:30] += 300
    return Frame(
        image=counts, time=BEGIN + timedelta(minutes=minutes), exposure_us=5e6, gain_db=0.0, pixel_format="Mono12",
        full_scale=4095, frame_id=minutes,
    )  # fmt: skip


def test_after_a_restart_the_first_image_is_repaired(kept: Kept) -> None:
    known = WarmPixelMap(kept.file)
    for minutes in MINUTES:
        known.repair(noise_at(minutes), None, serial="SIM-1")
    known.save()
    written = kept.path.stat().st_mtime_ns
    after, frame = WarmPixelMap(kept.file), noise_at(0)
    image = after.repair(frame, None, serial="SIM-1")
    assert len(after) == len(known) == 300
    assert int(frame.image.ravel()[:9000:30].min()) > 400 > int(image.ravel()[:9000:30].max())
    after.save()  # what was read is not written again
    assert kept.path.stat().st_mtime_ns == written
    assert after.repair(replace(frame, pixel_format="Mono8"), None, serial="SIM-1") is not image
    assert (len(after), kept.codes) == (0, ["warm_pixels_other_sensor"])


def test_the_worker_keeps_its_list_when_a_night_is_over(bench: Bench, tmp_path: Path) -> None:
    file = tmp_path / "warm-pixels.json"
    file.write_text("{")
    first = Bench(bench.archive, warm_pixels=file)
    first.serve(CAMERA)
    first.night(*(noise_at(minutes) for minutes in MINUTES))
    assert len(bench.archive.events.find("roof", kind="warm_pixels_unread")) == 1
    restarted = Bench(bench.archive, warm_pixels=file)
    restarted.worker.look_at(noise_at(0))
    restarted.worker.finish()
    newest = bench.archive.events.find("roof", kind="night")[0]
    assert (newest.details["n_images"], newest.details["n_warm_pixels"]) == (1, 300)
