"""Two pictures of one time in two subfolders: two cameras, or raw and annotated ones, followed and ingested."""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.fixtures.command_line import Sunarc, sunarc
from tests.imager.live.followed import Followed
from tests.imager.live.sky_pictures import Lens
from tests.imager.live.test_folder import MORNING, shot

from sunarc.imager.archive.archive import open_archive

__all__ = ["sunarc"]

OTHER = Lens(turn_deg=70.0)
TWO = "two_pictures_of_one_time"
N = 6


@pytest.fixture
def followed(tmp_path: Path) -> Iterator[Followed]:
    made = Followed(tmp_path, MORNING)
    made.turn()
    yield made
    made.close()


def annotated(content: bytes) -> bytes:
    """Return a picture with a text in a corner, compressed anew."""
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    cv2.putText(image, "ROOF", (5, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (200, 200, 200), 1)
    return cv2.imencode(".jpg", image)[1].tobytes()


def pair(time: datetime, kind: str) -> dict[str, bytes]:
    second = annotated(shot(time)) if kind == "annotated" else shot(time, lens=OTHER)
    name = f"image-{time:%Y%m%d%H%M%S}.jpg"
    return {f"first/{name}": shot(time), f"second/{name}": second}


@pytest.mark.parametrize("at_once", [True, False])
@pytest.mark.parametrize(("kind", "counting"), [("annotated", N), ("other camera", 0)])
def test_both_are_stored_one_counts_or_neither_and_it_is_said(
    followed: Followed, kind: str, counting: int, *, at_once: bool
) -> None:
    for _ in range(N):
        for name, content in pair(followed.clock.now().replace(microsecond=0), kind).items():
            followed.write(name, content)
            if not at_once:
                followed.turn()
        followed.turn()
        followed.clock.advance(51.0)
    points = followed.points()
    assert len(points) == 2 * N
    assert {one.folder for one in points if one.accepted} == ({"first"} if counting else set())
    assert sum(one.accepted for one in points) == counting
    aside = [one for one in points if not one.accepted]
    assert {one.findings[0].code for one in aside} == {TWO}
    (reason,) = [one for one in followed.service.board.snapshot().reasons if one.code == TWO]
    assert {str(reason.data["file"]).partition("/")[0], str(reason.data["other"]).partition("/")[0]} == {
        "first", "second"
    }  # fmt: skip
    assert "[folder] path" in reason.remedy


def test_the_condition_ends_with_the_second_pictures(followed: Followed) -> None:
    for n in range(20):
        time = followed.clock.now().replace(microsecond=0)
        for name, content in list(pair(time, "other camera").items())[: 2 if n < 4 else 1]:
            followed.write(name, content)
        followed.turn()
        followed.clock.advance(57.0)
        if n == 3:
            assert TWO in followed.codes()
    assert TWO not in followed.codes()
    assert sum(one.accepted for one in followed.points()) == 16


@pytest.mark.parametrize(("kind", "counting"), [("annotated", N), ("other camera", 0)])
def test_a_folder_with_two_pictures_is_ingested_to_the_same(
    sunarc: Sunarc, tmp_path: Path, kind: str, counting: int
) -> None:
    made = Followed(tmp_path, MORNING)
    site = made.service.settings.site
    made.close()
    state = tmp_path / "ingested"
    config = tmp_path / "sunarc.toml"
    config.write_text(
        f'name = "roof"\nstate = "{state}"\n[site]\nlatitude = {site.latitude}\n'
        f"longitude = {site.longitude}\naltitude = {site.altitude}\n"
    )
    images = tmp_path / "pictures"
    for n in range(N):
        for name, content in pair(MORNING + timedelta(minutes=n), kind).items():
            path = images / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    (images / "copy").mkdir()
    (images / "copy" / f"image-{MORNING:%Y%m%d%H%M%S}.jpg").write_bytes(shot(MORNING))

    def ingested(folder: Path, *more: str) -> tuple[int, int, bool, set[str]]:
        answer = sunarc("ingest", str(folder), "--config", str(config), "--workers=1", "--json", *more)
        assert answer.code == 0, answer.err
        summary = json.loads(answer.out)
        archive = open_archive(state / "sunarc.sqlite")
        points = archive.sightings.find("roof")
        archive.close()
        skipped = {one["code"] for one in summary["files_skipped"]}
        said = TWO in {one["code"] for one in summary["camera_findings"]}
        assert len(points) == 2 * N
        return sum(one.accepted for one in points), summary["known"], said, skipped

    assert ingested(images) == (counting, 0, True, {"file_copy"})
    assert ingested(images)[:2] == (counting, 2 * N)
    assert ingested(images, "--reprocess")[0] == counting
    assert ingested(images / "second")[1] == N  # a part of it is known by its names
