from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from PIL import Image

from sunarc.archive import SunPoint, open_archive
from sunarc.imaging import jpeg_with, png_with
from sunarc.simulation import SGP, Scene, SceneOptions, true_camera

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(true_camera(), SGP, options=SceneOptions(nd_transmission=0.01))


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "sunarc.toml"
    path.write_text(
        f'name = "roof"\nstate = "{tmp_path}/state"\n'
        "[site]\nlatitude = 36.604043\nlongitude = -97.484856\naltitude = 318.0\n"
    )
    (tmp_path / "images").mkdir()
    return path


def frame(scene: Scene, moment: datetime) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return scene.render(round(moment.timestamp() * 1e6), exposure_us=20.0, full_scale=255).astype(np.uint8)


def ingest(sunarc: Sunarc, config: Path, *more: str) -> dict[str, Any]:
    answer = sunarc("ingest", str(config.parent / "images"), "--config", str(config), "--json", *more)
    assert answer.code == 0, answer.err
    loaded: dict[str, Any] = json.loads(answer.out)
    return loaded


def stored(config: Path) -> tuple[SunPoint, ...]:
    archive = open_archive(config.parent / "state" / "sunarc.sqlite")
    points = archive.sun_points("roof")
    archive.close()
    return points


def test_a_folder_fills_the_archive_and_what_it_has_is_skipped(sunarc: Sunarc, scene: Scene, config: Path) -> None:
    images = config.parent / "images"
    for number in range(3):
        moment = NOON + timedelta(minutes=10 * number)
        cv2.imwrite(str(images / f"{moment:%Y%m%dT%H%M%SZ}_20us.png"), frame(scene, moment))
    (images / "20130513T190000Z_20us.png").write_bytes(b"torn")
    cv2.imwrite(str(images / "undated.png"), frame(scene, NOON))
    first = ingest(sunarc, config)
    assert (first["added"], first["skipped"]) == (3, 2)
    assert {Path(row["file"]).name for row in first["files_skipped"]} == {"20130513T190000Z_20us.png", "undated.png"}
    again = ingest(sunarc, config)
    assert (again.get("added", 0), again["known"]) == (0, 3)
    points = stored(config)
    assert [point.time for point in points] == [NOON + timedelta(minutes=10 * n) for n in range(3)]
    assert {point.exposure_us for point in points} == {20.0}
    for point in points:
        assert point.accepted
        assert (point.x_px, point.y_px) == pytest.approx(tuple(scene.sun_pixel(point.time.timestamp())), abs=0.05)


def test_times_come_from_patterns_sidecars_and_exif(sunarc: Sunarc, scene: Scene, config: Path) -> None:
    images = config.parent / "images"
    cv2.imwrite(str(images / "sky_a.png"), frame(scene, NOON))
    (images / "sky_a.json").write_text(json.dumps({"time_utc": "2013-05-13T18:30:00Z", "exposure_us": 20}))
    exif = Image.Exif()
    exif[0x8769] = {36867: "2013:05:13 13:40:00", 36881: "-05:00"}
    Image.fromarray(frame(scene, NOON + timedelta(minutes=10))).save(images / "sky_b.png", exif=exif)
    cv2.imwrite(str(images / "2013-05-13_13-50-00.png"), frame(scene, NOON + timedelta(minutes=20)))
    assert ingest(sunarc, config, "--utc-offset=-5")["added"] == 3
    assert [point.time for point in stored(config)] == [NOON + timedelta(minutes=10 * n) for n in range(3)]


def test_a_pattern_can_be_given(sunarc: Sunarc, scene: Scene, config: Path) -> None:
    cv2.imwrite(str(config.parent / "images" / "cam 13.05.13 18h30.png"), frame(scene, NOON))
    assert ingest(sunarc, config, "--time-pattern", "cam %d.%m.%y %Hh%M")["added"] == 1
    assert [point.time for point in stored(config)] == [NOON]


def test_images_of_another_size_are_not_mixed_in(sunarc: Sunarc, scene: Scene, config: Path) -> None:
    images = config.parent / "images"
    cv2.imwrite(str(images / "20130513T183000Z_20us.png"), frame(scene, NOON))
    cv2.imwrite(str(images / "20130513T184000Z_20us.png"), np.zeros((100, 100), dtype=np.uint8))
    told = ingest(sunarc, config)
    assert (told["added"], told["skipped"]) == (1, 1)
    assert "image size" in told["files_skipped"][0]["reason"]


def test_our_own_composites_tell_their_time_and_their_previews_are_left_out(
    sunarc: Sunarc, scene: Scene, config: Path
) -> None:
    moment = NOON.replace(microsecond=123_456)
    document = {"schema": "sunarc.image/1", "time_utc": "2013-05-13T18:30:00.123456Z", "preview": False}
    image = frame(scene, moment)
    stem = str(config.parent / "images" / "20130513T183000.123Z_hdr")
    png = cv2.imencode(".png", image)[1].tobytes()
    Path(stem + ".png").write_bytes(png_with(png, document, software="sunarc", created="2013"))
    jpeg = cv2.imencode(".jpg", image)[1].tobytes()
    Path(stem + ".jpg").write_bytes(jpeg_with(jpeg, document | {"preview": True}))
    told = ingest(sunarc, config)
    assert (told["added"], told["skipped"]) == (1, 1)
    assert [point.time for point in stored(config)] == [moment]


def test_a_folder_that_is_none_is_one_line_and_exit_2(sunarc: Sunarc, config: Path) -> None:
    answer = sunarc("ingest", str(config.parent / "absent"), "--config", str(config))
    assert answer.code == 2
    assert "is no folder" in answer.err
