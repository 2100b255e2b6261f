"""Images of the night among those of the day: their stars become sightings where a calibration is served."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tests.archives.test_ingest_times import taken
from tests.fixtures.calibrations import SITE, chosen_calibration
from tests.fixtures.command_line import Sunarc
from tests.public.test_star_files import CAMERA, SIZE, night_image

from sunarc.common.findings import FindingError
from sunarc.formats.calibration_document import to_document
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.archive.images import ImageStore
from sunarc.imager.archive.values import CameraRecord, SunPointColumns
from sunarc.imager.workers.night.images import night_picture, store_picture
from sunarc.optics.forward import project
from sunarc.sky.night import body_directions

NIGHT = ("20260313T060000Z", "20260313T064000Z", "20260313T072000Z")


def written(config: Path) -> None:
    """Write three images of a night, as a JPEG has them, one torn file, and one of the day without a sun."""
    rng = np.random.default_rng(1)
    hot = rng.uniform(60.0, SIZE - 60.0, (60, 2)).round() + 0.2
    for name in NIGHT:
        bright = night_image(rng, name.replace("T", "_").rstrip("Z"), hot)
        grey = np.clip(bright.astype(np.float64) / 8.0, 0, 255).astype(np.uint8)
        cv2.imwrite(str(config.parent / "images" / f"{name}.jpg"), np.repeat(grey[..., None], 3, axis=-1))
    (config.parent / "images" / "20260313T080000Z.jpg").write_bytes(b"torn")
    day = np.full((SIZE, SIZE, 3), 90, dtype=np.uint8)
    cv2.imwrite(str(config.parent / "images" / "20260313T180000Z.png"), day)


def serve(config: Path) -> None:
    """Store a camera and a calibration that is served."""
    calibration = chosen_calibration(
        CAMERA,
        names=("principal_point_x_px", "principal_point_y_px"),
        covariance=0.01 * np.eye(2),
        orders=np.array([[1, 1]]),
    )
    database = config.parent / "state" / "sunarc.sqlite"
    database.parent.mkdir(exist_ok=True)
    upgrade(database)
    since = datetime(2026, 3, 1, tzinfo=UTC)
    with open_archive(database) as archive:
        archive.cameras.save(CameraRecord.at(SITE, name="roof", width=SIZE, height=SIZE))
        archive.calibrations.add(
            to_document(
                calibration, id="c", camera="roof", state="candidate", created_at=since, valid_from=since,
                valid_until=None, pose_epoch="roof-1", software_version="0",
            )
        )  # fmt: skip
        archive.calibrations.activate("c")


def ingested(sunarc: Sunarc, config: Path, *more: str) -> dict[str, Any]:
    done = sunarc("ingest", str(config.parent / "images"), "--config", str(config), "--workers=1", "--json", *more)
    assert done.code == 0, done.err
    answer: dict[str, Any] = json.loads(done.out)
    return answer


def test_nights_wait_for_a_calibration_and_are_looked_at_once(sunarc: Sunarc, config: Path) -> None:
    written(config)
    before = ingested(sunarc, config)
    assert before["by_reason"] == {"file_at_night": 4}
    assert [finding["code"] for finding in before["camera_findings"]][-1:] == ["nights_without_calibration"]
    serve(config)
    first = ingested(sunarc, config)
    assert first["by_reason"] == {"file_not_image": 1}
    (night,) = first["nights"]
    assert (night["date"], night["images"], night["accepted"]) == ("2026-03-12", 3, 3)
    assert night["verdict"] in {"clear", "partly"}
    assert night["stored"] > 60
    with open_archive(config.parent / "state" / "sunarc.sqlite") as archive:
        stars = archive.sightings.columns("roof", body=None)
        stars = stars.select(stars.body != "sun")
    assert stars.unix_s.size == night["stored"]
    true = project(CAMERA, body_directions(stars.body, stars.unix_s, SITE))
    apart = np.linalg.norm(stars.pixels - true, axis=-1)
    assert 0.005 < np.median(apart) < 0.1
    assert np.max(apart) < 2.0
    again = ingested(sunarc, config)
    assert again["nights"] == []
    assert again["nights_known"] == 4
    replaced_where_named_again(sunarc, config, stars)


def test_nights_that_are_stored_upside_down_are_named_as_such(sunarc: Sunarc, config: Path) -> None:
    written(config)
    for name in NIGHT:
        file = config.parent / "images" / f"{name}.jpg"
        image = cv2.imread(str(file))
        assert image is not None
        cv2.imwrite(str(file), image[::-1])
    ingested(sunarc, config)
    serve(config)
    found = ingested(sunarc, config)
    assert [night["accepted"] for night in found["nights"]] == [0]
    flips = [one["data"]["flip"] for one in found["camera_findings"] if one["code"] == "stars_flipped"]
    assert flips == ["its rows in reverse order"]


def replaced_where_named_again(sunarc: Sunarc, config: Path, before: SunPointColumns) -> None:
    """Look at the night once more, with one image in cloud and sightings of another detector in the archive."""
    rng, database = np.random.default_rng(2), config.parent / "state" / "sunarc.sqlite"
    cloud = rng.poisson(90.0, (SIZE, SIZE)).astype(np.uint8)
    cv2.imwrite(str(config.parent / "images" / f"{NIGHT[0]}.jpg"), cloud)
    clouded = datetime.strptime(f"{NIGHT[0]}+0000", "%Y%m%dT%H%M%SZ%z")
    with open_archive(database) as archive:
        former = archive.sightings.find("roof", body=None, until=clouded + timedelta(days=1), accepted=True)
        stars = [one for one in former if one.body != "sun"]
        archive.sightings.replace([replace(one, x_px=(one.x_px or 0.0) + 5.0) for one in stars])
        archive.sightings.replace([replace(stars[-1], body="star:HIP1")])  # which is no star of the catalogue
    anew = ingested(sunarc, config, "--reprocess")
    assert [(one["accepted"], one["images"]) for one in anew["nights"]] == [(2, 3)]
    with open_archive(database) as archive:
        after = archive.sightings.columns("roof", body=None)
        (aside,) = archive.sightings.find("roof", body="star:HIP1")
        assert [night.n_accepted for night in archive.nights.find("roof")] == [2]
        assert len(archive.events.find("roof", kind="night")) == 2
    assert (aside.accepted, aside.verdict) == (False, "set_aside")
    after = after.select(after.body != "sun")
    kept = after.unix_s == clouded.timestamp()
    assert int(kept.sum()) == int((before.unix_s == clouded.timestamp()).sum())
    off = np.linalg.norm(after.pixels - project(CAMERA, body_directions(after.body, after.unix_s, SITE)), axis=-1)
    assert np.min(off[kept]) > 4.0
    assert np.max(off[~kept]) < 2.0


def test_the_picture_that_the_service_keeps_of_a_night_is_no_image_to_look_at(tmp_path: Path) -> None:
    store, time = ImageStore(tmp_path), datetime(2026, 3, 13, 6, tzinfo=UTC)
    picture = night_picture(np.eye(64, dtype=np.uint16), time, 1)
    assert store_picture(store, picture, [], calibration=None, image_size=(64, 64))
    ((_, path),) = store.between(kind="night.jpg", limit=1)
    assert cv2.imread(str(path)) is not None
    for code in ("file_sidecar", "file_preview"):  # with the names of its stars beside it, and without
        with pytest.raises(FindingError) as refused:
            taken(path)
        assert refused.value.finding.code == code
        path.with_suffix(".json").unlink(missing_ok=True)
