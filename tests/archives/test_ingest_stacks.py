"""Stacks of exposures through the command line: one sighting from all of them, and each file is known."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from tests.detection.photo.suns import SUN, exposed

from sunarc.common.findings import Finding
from sunarc.detection.photo.ordinary_image import Photo, detect_sun_in_photo
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.values import SunPoint

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

TIME = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
EXPOSURES = {1000: 1.0, 100: 0.1, 10: 0.01}
SLOPE = 0.8
NAMES = sorted(f"20130513T183000Z_{us}us.png" for us in EXPOSURES)


def write_stack(config: Path, *, time: str = "183000", only: int | None = None) -> None:
    for us, exposure in EXPOSURES.items():
        if only in {None, us}:
            path = config.parent / "images" / f"20130513T{time}Z_{us}us.png"
            cv2.imwrite(str(path), exposed(exposure, slope=SLOPE, seed=us))


def ingest(sunarc: Sunarc, config: Path, *more: str) -> dict[str, Any]:
    answer = sunarc("ingest", str(config.parent / "images"), "--config", str(config), "--workers=1", "--json", *more)
    assert answer.code == 0, answer.err
    loaded: dict[str, Any] = json.loads(answer.out)
    return loaded


def counts(summary: dict[str, Any]) -> tuple[int, int, int, int]:
    return summary["accepted"], summary["rejected"], summary["stacked"], summary["known"]


def stored(config: Path) -> Iterator[SunPoint]:
    with open_archive(config.parent / "state" / "sunarc.sqlite") as archive:
        yield from sorted(archive.sightings.find("roof"), key=lambda point: point.file)


def error_px(x: float | None, y: float | None) -> float:
    assert x is not None
    assert y is not None
    return math.hypot(x - SUN[0], y - SUN[1])


def test_a_stack_is_one_sighting_in_which_the_short_exposure_rules(sunarc: Sunarc, config: Path) -> None:
    write_stack(config)
    assert counts(ingest(sunarc, config)) == (1, 0, 2, 0)
    first, *others = stored(config)
    assert [point.file for point in (first, *others)] == NAMES
    assert (first.accepted, first.verdict, first.time) == (True, "clear", TIME)
    assert {(point.accepted, point.verdict, point.x_px) for point in others} == {(False, "in_stack", None)}
    assert all(point.findings == (Finding("stack_member", {"file": NAMES[0]}),) for point in others)
    alone = detect_sun_in_photo(Photo(exposed(1.0, slope=SLOPE, seed=1000), 255))
    assert error_px(first.x_px, first.y_px) < 0.35
    assert (first.sigma_px or math.inf) < 0.8 * (alone.sigma_px or 0.0)
    assert (first.radius_px or math.inf) < 0.5 * (alone.radius_px or 0.0)


def test_each_file_is_known_and_looked_at_again_with_its_stack(sunarc: Sunarc, config: Path) -> None:
    write_stack(config, only=1000)
    assert counts(ingest(sunarc, config)) == (1, 0, 0, 0)
    (alone,) = stored(config)
    write_stack(config)
    assert counts(ingest(sunarc, config)) == (1, 0, 2, 0)  # the accepted one of the file alone is replaced
    (together,) = [point for point in stored(config) if point.accepted]
    assert (together.sigma_px or math.inf) < (alone.sigma_px or 0.0)
    assert counts(ingest(sunarc, config)) == (0, 0, 0, 3)
    assert counts(ingest(sunarc, config, "--reprocess")) == (1, 0, 2, 0)
    assert [point.file for point in stored(config)] == NAMES


def test_a_file_of_a_stack_that_is_left_out_does_not_spoil_it(sunarc: Sunarc, config: Path) -> None:
    write_stack(config)
    write_stack(config, time="184000")
    images = config.parent / "images"
    (images / NAMES[1]).write_bytes(b"torn")
    cv2.imwrite(str(images / NAMES[2]), np.zeros((20, 20), np.uint8))
    cv2.imwrite(str(images / "20130513T184000Z_1us.png"), np.zeros((300, 300), np.uint16))  # not like the others
    summary = ingest(sunarc, config)
    assert {row["file"]: row["code"] for row in summary["files_skipped"]} == {
        NAMES[1]: "file_not_image",
        NAMES[2]: "file_size_differs",
    }
    assert counts(summary) == (2, 1, 2, 0)


@pytest.mark.parametrize(("files", "stacked"), [(32, 31), (33, 0)])
def test_too_many_images_of_one_time_are_no_stack(sunarc: Sunarc, config: Path, files: int, stacked: int) -> None:
    for number in range(files):
        name = f"20130513T183000Z_{number:03d}.png"
        cv2.imwrite(str(config.parent / "images" / name), np.full((40, 50), 40, np.uint8))
    assert counts(ingest(sunarc, config)) == (0, files - stacked, stacked, 0)
