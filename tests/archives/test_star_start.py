"""A camera of nights alone, or one that is given: its states, epochs and calibrations without a sun."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tests.archives.in_process import InProcess, use
from tests.detection.stars.rendering import counted, expected
from tests.fixtures.calibrations import SITE, chosen_calibration
from tests.public.test_star_files import CAMERA, SIZE, unix_s

from sunarc.archives.run import ReanalysisOptions, reanalyse
from sunarc.common.errors import InputError
from sunarc.formats.calibration_document import from_document, to_document
from sunarc.imager.runtime.clock import SystemClock
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.sky.directions import angles_from_direction
from sunarc.sky.night import night_sky
from sunarc.sky.site import Site, relative_air_mass
from sunarc.sources.image_times import ASSUMED_UTC
from sunarc.sources.index import CameraPlan, Selector, index_archive

TURNED = replace(
    CAMERA,
    rotation_cam_enu=rotation_vector(rotation_matrix(CAMERA.rotation_cam_enu) @ rotation_matrix((0.03, 0.02, 0.2))),
)
"""The same lens after a move by 11 degrees."""
NIGHTS = {"20260313": CAMERA, "20260315": TURNED}
HOURS = ("053000", "063000", "073000")


def night_image(rng: np.random.Generator, name: str, camera: Camera) -> Any:  # noqa: ANN401 - an array
    sky = night_sky(unix_s(name), SITE, faintest=5.5)
    zenith, _ = angles_from_direction(sky.directions)
    sky, zenith = sky.select(zenith < 84.0), zenith[zenith < 84.0]
    light = 400_000.0 * 10.0 ** (-0.4 * (sky.magnitude + 0.25 * (relative_air_mass(zenith) - 1.0)))
    return counted(rng, expected(project(camera, sky.directions), light, size=SIZE, width=1.0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return two nights of a camera that was turned between them, and one of cloud."""
    folder, rng = tmp_path_factory.mktemp("roof"), np.random.default_rng(1)
    for (night, camera), hour in itertools.product(NIGHTS.items(), HOURS):
        cv2.imwrite(str(folder / f"{night}_{hour}.png"), night_image(rng, f"{night}_{hour}", camera))
    for hour in HOURS[:2]:
        cloud = rng.poisson(900.0, (SIZE, SIZE)).astype(np.uint16)
        cv2.imwrite(str(folder / f"20260317_{hour}.png"), cloud)
    return folder


def analysed(
    folder: Path, target: Path, patch: pytest.MonkeyPatch, *, site: Site = SITE, calibration: Path | None = None
) -> tuple[dict[str, Any], InProcess]:
    """Return the report of a folder's camera, and what was computed for it."""
    plan = CameraPlan(
        name="roof", site=site, selector=Selector((str(folder),)), rules=ASSUMED_UTC, calibration=calibration
    )
    cluster = InProcess()
    use(cluster, patch)
    options = ReanalysisOptions(target=target, exports=False)
    summary = reanalyse(index_archive([plan]), options, clock=SystemClock())
    (camera,) = summary.report["cameras"]
    return camera, cluster


def test_a_camera_of_nights_alone_is_found_with_its_move(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera, _ = analysed(folder, tmp_path / "out", monkeypatch)
    epochs = camera["epochs"]
    assert [(one["cause"], one["start"][:10], one["end"][:10], one["accepted"]) for one in epochs] == [
        ("start", "2026-03-13", "2026-03-13", True), ("moved", "2026-03-15", "2026-03-15", True),
    ]  # fmt: skip
    assert (camera["images"], camera["nights"]["images"], camera["findings"]) == (0, 8, [])
    up = np.array([[0.0, np.sin(one), np.cos(one)] for one in np.radians([0.0, 40.0, 70.0])])
    for number, true in ((1, CAMERA), (2, TURNED)):
        document = json.loads((tmp_path / "out" / "calibrations" / "roof" / f"00{number}.json").read_text())
        found = from_document(document).camera
        assert np.max(np.linalg.norm(project(found, up) - project(true, up), axis=-1)) < 0.5
        assert document["evidence"]["selection"]["n_stars"] > 60
    assert (tmp_path / "out" / "stars.csv").read_text().count("\n") > 150
    assert "roof" in (tmp_path / "out" / "report.html").read_text()


def test_a_given_camera_needs_no_search_and_another_is_told_by_its_size(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("principal_point_x_px", "principal_point_y_px")
    given = replace(
        chosen_calibration(CAMERA, names=names, covariance=0.01 * np.eye(2), orders=np.array([[1, 1]])), site=SITE
    )
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(document_of(given)))
    monkeypatch.setattr("sunarc.archives.star_start.blind_result", lambda *_, **__: pytest.fail("searched"))
    two = tmp_path / "two"
    two.mkdir()
    for image in sorted(folder.iterdir())[:3]:
        (two / image.name).symlink_to(image)
    camera, _ = analysed(two, tmp_path / "out", monkeypatch, calibration=path)
    assert [(one["cause"], one["accepted"]) for one in camera["epochs"]] == [("start", True)]
    other = replace(given, camera=replace(CAMERA, width=SIZE + 2))
    path.write_text(json.dumps(document_of(other)))
    with pytest.raises(InputError, match="642"):
        analysed(two, tmp_path / "out", monkeypatch, calibration=path)


def document_of(calibration: Any) -> dict[str, Any]:  # noqa: ANN401 - a calibration
    at = datetime.fromisoformat("2026-03-13T06:00:00Z")
    return to_document(
        calibration, id="a", camera="roof", state="candidate", created_at=at, valid_from=at, valid_until=None,
        pose_epoch="1", software_version="1",
    )  # fmt: skip


def test_at_the_latitude_of_the_other_sign_nothing_is_accepted(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = tmp_path / "one"
    one.mkdir()
    for image in sorted(folder.iterdir())[:3]:
        (one / image.name).symlink_to(image)
    wrong = Site(latitude=-SITE.latitude, longitude=SITE.longitude, altitude=0.0)
    camera, _ = analysed(one, tmp_path / "out", monkeypatch, site=wrong)
    assert (camera["epochs"], camera["nights"]["images"]) == ([], 3)
    assert camera["findings"][-1]["code"] == "camera_at_night"
