from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from PIL import Image

from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.values import SunPoint
from sunarc.imaging.metadata import jpeg_with, png_with
from sunarc.lab.simulation.options import SceneOptions
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(true_camera(), SGP, options=SceneOptions(nd_transmission=0.01))


def frame(scene: Scene, moment: datetime) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return scene.render(round(moment.timestamp() * 1e6), exposure_us=20.0, full_scale=255).astype(np.uint8)


def ingest(sunarc: Sunarc, config: Path, *more: str) -> dict[str, Any]:
    answer = sunarc("ingest", str(config.parent / "images"), "--config", str(config), "--workers=1", "--json", *more)
    assert answer.code == 0, answer.err
    loaded: dict[str, Any] = json.loads(answer.out)
    return loaded


def stored(config: Path) -> tuple[SunPoint, ...]:
    archive = open_archive(config.parent / "state" / "sunarc.sqlite")
    points = archive.sightings.find("roof")
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
    assert (first["accepted"], first["rejected"], first["known"], first["skipped"]) == (3, 0, 0, 2)
    skipped = {row["file"]: row["code"] for row in first["files_skipped"]}
    assert skipped == {"20130513T190000Z_20us.png": "file_not_image", "undated.png": "file_time_unknown"}
    assert Path(first["contact_sheet"]).is_file()
    again = ingest(sunarc, config)
    assert (again["accepted"], again["rejected"], again["known"]) == (0, 0, 3)
    assert again["by_verdict"] == first["by_verdict"] == {"clear": 3}
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
    assert ingest(sunarc, config, "--utc-offset=-5")["accepted"] == 3
    assert [point.time for point in stored(config)] == [NOON + timedelta(minutes=10 * n) for n in range(3)]


def test_a_pattern_can_be_given(sunarc: Sunarc, scene: Scene, config: Path) -> None:
    cv2.imwrite(str(config.parent / "images" / "cam 13.05.13 18h30.png"), frame(scene, NOON))
    assert ingest(sunarc, config, "--time-pattern", "cam %d.%m.%y %Hh%M")["accepted"] == 1
    assert [point.time for point in stored(config)] == [NOON]


def test_images_of_another_size_are_not_mixed_in(sunarc: Sunarc, scene: Scene, config: Path) -> None:
    images = config.parent / "images"
    cv2.imwrite(str(images / "20130513T183000Z_20us.png"), frame(scene, NOON))
    cv2.imwrite(str(images / "20130513T184000Z_20us.png"), np.zeros((100, 100), dtype=np.uint8))
    summary = ingest(sunarc, config)
    assert (summary["accepted"], summary["skipped"]) == (1, 1)
    assert summary["by_reason"] == {"file_size_differs": 1}


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
    summary = ingest(sunarc, config)
    assert (summary["accepted"], summary["skipped"]) == (1, 1)
    assert [point.time for point in stored(config)] == [moment]


def test_a_folder_that_is_none_is_one_line_and_exit_2(sunarc: Sunarc, config: Path) -> None:
    answer = sunarc("ingest", str(config.parent / "absent"), "--config", str(config))
    assert answer.code == 2
    assert str(config.parent / "absent") in answer.err


def test_every_exposure_of_a_stack_is_looked_at(sunarc: Sunarc, scene: Scene, config: Path) -> None:
    stack = config.parent / "images" / "20130513T183000Z"
    stack.mkdir()
    for number in range(14):
        cv2.imwrite(str(stack / f"20130513T183000Z_{number:02d}.png"), frame(scene, NOON)[::8, ::8])
    summary = ingest(sunarc, config)
    assert summary["accepted"] + summary["rejected"] == 14
    assert {point.file for point in stored(config)} == {f"20130513T183000Z_{n:02d}.png" for n in range(14)}
    assert {(point.time, point.ingest_pass) for point in stored(config)} == {(NOON, 1)}


def test_the_same_file_twice_below_a_folder_is_looked_at_once(sunarc: Sunarc, config: Path) -> None:
    for name in ("a", "b"):
        folder = config.parent / "images" / name
        folder.mkdir()
        cv2.imwrite(str(folder / "20130513T183000Z.png"), np.zeros((40, 50), dtype=np.uint8))
    summary = ingest(sunarc, config)
    assert (summary["rejected"], summary["by_reason"]) == (1, {"file_copy": 1})
    assert ingest(sunarc, config)["known"] == 1


def test_refused_images_are_counted_as_such_and_another_method_looks_again(
    sunarc: Sunarc, scene: Scene, config: Path
) -> None:
    cv2.imwrite(str(config.parent / "images" / "20130513T183000Z_20us.png"), frame(scene, NOON))
    refused = ingest(sunarc, config, "--method", "paper")
    assert (refused["accepted"], refused["rejected"]) == (0, 1)
    again = ingest(sunarc, config, "--method", "paper")
    assert (again["accepted"], again["rejected"], again["known"]) == (0, 0, 1)
    other = ingest(sunarc, config, "--method", "disc")
    assert (other["accepted"], other["rejected"], other["known"]) == (1, 0, 0)
    assert other["by_verdict"] == {"clear": 1}
    assert sorted((point.method, point.accepted) for point in stored(config)) == [("disc", True), ("paper", False)]


def test_reprocessing_replaces_what_is_stored(sunarc: Sunarc, scene: Scene, config: Path) -> None:
    path = config.parent / "images" / "20130513T183000Z_20us.png"
    cv2.imwrite(str(path), np.zeros((1748, 1748), dtype=np.uint8))
    assert ingest(sunarc, config)["rejected"] == 1
    cv2.imwrite(str(path), frame(scene, NOON))
    assert ingest(sunarc, config)["known"] == 1
    assert ingest(sunarc, config, "--reprocess")["accepted"] == 1
    assert [point.accepted for point in stored(config)] == [True]


def test_sightings_of_version_0_2_are_known_to_one_file_each(sunarc: Sunarc, config: Path) -> None:
    images = config.parent / "images"
    dark = np.zeros((40, 50), dtype=np.uint8)
    cv2.imwrite(str(images / "a_20130513T183000Z.png"), dark)
    ingest(sunarc, config)
    for new in (0, 1):
        with closing(sqlite3.connect(config.parent / "state" / "sunarc.sqlite")) as connection, connection:
            connection.execute("UPDATE sun_point SET file = '', ingest_pass = NULL")
        if new:
            cv2.imwrite(str(images / "b_20130513T183000Z.png"), dark)
        summary = ingest(sunarc, config)
        # With a new image of its time it is looked at again: they may be a stack.
        assert (summary["known"], summary["rejected"]) == ((0, 2) if new else (1, 0))
    assert [point.file for point in stored(config)] == ["a_20130513T183000Z.png", "b_20130513T183000Z.png"]


def test_the_usual_size_is_the_cameras_whatever_comes_first(sunarc: Sunarc, config: Path) -> None:
    for number in range(4):
        side = 30 if number == 0 else 40
        path = config.parent / "images" / f"20130513T18{number:02d}00Z.png"
        cv2.imwrite(str(path), np.zeros((side, side), dtype=np.uint8))
    summary = ingest(sunarc, config)
    assert (summary["rejected"], summary["by_reason"]) == (3, {"file_size_differs": 1})


def test_the_summary_names_counts_and_the_contact_sheet(sunarc: Sunarc, config: Path) -> None:
    cv2.imwrite(str(config.parent / "images" / "20130513T183000Z.png"), np.zeros((40, 50), dtype=np.uint8))
    (config.parent / "images" / "undated.png").write_bytes(b"")
    sheet = config.parent / "sheet.png"
    answer = sunarc(
        "ingest", str(config.parent / "images"), "--config", str(config), "--workers=1", "--contact-sheet", str(sheet)
    )
    assert answer.code == 0
    assert "0 accepted, 1 rejected, 0 known already, 1 skipped" in answer.out
    assert str(sheet) in answer.out
    with Image.open(sheet) as picture:
        assert picture.width == 2200


def test_no_worker_is_refused(sunarc: Sunarc, config: Path) -> None:
    answer = sunarc("ingest", str(config.parent / "images"), "--config", str(config), "--workers", "0")
    assert answer.code == 2
