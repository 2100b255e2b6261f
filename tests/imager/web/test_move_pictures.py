"""The pictures before and after a move are served with the horizon where each calibration has it."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.served import LENS, NOON, Make

from sunarc.imager.archive.move_pictures import MovePictures
from sunarc.imager.archive.values import Event
from sunarc.imager.web.routes.record import draw_horizon
from sunarc.optics.camera import Camera
from sunarc.optics.inverse import unproject

if TYPE_CHECKING:
    from tests.fixtures.served import Made


def moved(time: datetime = NOON, kind: str = "bump", event_id: int | None = None) -> Event:
    return Event(
        time=time,
        kind=kind,
        severity="alarm",
        text="moved",
        camera="roof",
        details={"earliest_unix_s": time.timestamp() - 60.0, "to_acknowledge": True},
        id=event_id,
    )


def picture(folder: Path, level: int) -> Path:
    path = folder / f"{level}.png"
    cv2.imwrite(str(path), np.full((174, 174, 3), level, np.uint8))
    return path


@pytest.fixture
def pictures(tmp_path: Path) -> MovePictures:
    return MovePictures(tmp_path / "moves")


@pytest.fixture
def served(make: Make, pictures: MovePictures, tmp_path: Path) -> tuple[Made, int]:
    made = make(history="filled", moves=pictures)
    event = made.archive.events.add(moved())
    pictures.remember(picture(tmp_path, 40), sighted_at=NOON - timedelta(minutes=5))
    pictures.keep(event, picture(tmp_path, 200), sighted_at=NOON + timedelta(minutes=1))
    assert event.id is not None
    return made, event.id


def pixels(answer: Any) -> NDArray[np.uint8]:  # noqa: ANN401 - of httpx
    assert (answer.status_code, answer.headers["content-type"]) == (200, "image/jpeg")
    decoded = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    return np.asarray(decoded, np.uint8)


def test_each_side_is_served_with_its_own_time(served: tuple[Made, int]) -> None:
    made, event = served
    before, after = (made.client.get(f"/v1/events/{event}/pictures/{side}") for side in ("before", "after"))
    assert [int(np.median(pixels(one))) for one in (before, after)] == [40, 200]
    assert [one.headers["sunarc-time"] for one in (before, after)] == ["2013-05-13T18:25:00Z", "2013-05-13T18:31:00Z"]
    small = made.client.get(f"/v1/events/{event}/pictures/after", params={"width": 58})
    assert pixels(small).shape == (58, 58, 3)
    tag = {"if-none-match": before.headers["etag"]}
    assert made.client.get(f"/v1/events/{event}/pictures/before", headers=tag).status_code == 304


def test_the_horizon_is_drawn_by_the_calibration_of_then(served: tuple[Made, int]) -> None:
    made, event = served
    answer = made.client.get(f"/v1/events/{event}/pictures/after", params={"horizon": "true"})
    assert answer.headers["sunarc-calibration"] == "second"
    assert np.count_nonzero(np.ptp(pixels(answer).astype(int), axis=-1) > 60) > 100


def test_the_line_lies_where_the_camera_sees_the_horizon() -> None:
    """By the exact inverse of the camera: each drawn pixel looks at the horizon, to within the width of the line."""
    for size in (LENS.width, 400):
        drawn = np.zeros((size, size, 3), np.uint8)
        draw_horizon(drawn, LENS)
        rows, columns = np.nonzero(drawn[..., 2])
        assert rows.size > 2 * size
        points = (np.stack([columns, rows], -1) + 0.5) * LENS.width / size - 0.5
        wide_px = (1.0 + max(1, round(size / 500))) * LENS.width / size
        assert off_deg(LENS, points) < 0.135 * wide_px  # of a pixel at the horizon


def off_deg(camera: Camera, points: NDArray[np.float64]) -> float:
    """Return by how much directions of pixels lie off the horizon at most, degrees."""
    with np.errstate(all="ignore"):
        up = unproject(camera, points)[:, 2]
    return float(np.degrees(np.nanmax(np.abs(np.arcsin(up)))))


def test_what_was_not_kept_is_not_found(served: tuple[Made, int], make: Make) -> None:
    made, event = served
    other = made.archive.events.add(moved(NOON - timedelta(days=1)))
    assert made.client.get(f"/v1/events/{other.id}/pictures/before").status_code == 404
    assert made.client.get(f"/v1/events/{event + 99}/pictures/before").status_code == 404
    assert made.client.get(f"/v1/events/{event}/pictures/between").status_code == 422
    without = make(history="filled")
    assert without.client.get("/v1/events/1/pictures/before").status_code == 404


def test_the_picture_before_is_of_before_the_last_sighting_that_agreed(pictures: MovePictures, tmp_path: Path) -> None:
    for minutes, level in ((-30, 30), (-15, 60), (-0.5, 90)):
        pictures.remember(picture(tmp_path, level), sighted_at=NOON + timedelta(minutes=minutes))
    pictures.keep(moved(), picture(tmp_path, 120), sighted_at=NOON - timedelta(seconds=1))  # not after it yet
    kept = pictures.path(moved(), "before")
    assert kept is not None
    assert pictures.time(kept) == NOON - timedelta(minutes=15)
    assert pictures.path(moved(), "after") is None


def test_a_composite_has_the_time_of_its_name(pictures: MovePictures, tmp_path: Path) -> None:
    composite = tmp_path / "20130513T182910.250Z_hdr.jpg"
    picture(tmp_path, 40).rename(composite)
    pictures.keep(moved(), composite, sighted_at=NOON + timedelta(minutes=1))
    assert pictures.path(moved(), "after") is None  # taken before the move


def test_the_folder_stays_small(pictures: MovePictures, tmp_path: Path) -> None:
    shown = picture(tmp_path, 40)
    for n in range(120):
        time = NOON + timedelta(minutes=15 * n)
        pictures.remember(shown, sighted_at=time - timedelta(minutes=5))
        pictures.keep(moved(time), shown, sighted_at=time)
    assert len(list(pictures.folder.glob("lately_*"))) == 24
    assert len(list(pictures.folder.glob("move_*"))) == 100
    assert pictures.is_complete(moved(NOON + timedelta(minutes=15 * 119)))


def test_a_picture_that_cannot_be_read_is_left_out(pictures: MovePictures, tmp_path: Path) -> None:
    (tmp_path / "broken.jpg").write_bytes(b"no picture")
    pictures.remember(tmp_path / "broken.jpg", sighted_at=NOON)
    pictures.remember(tmp_path / "gone.jpg", sighted_at=NOON)
    assert list(pictures.folder.glob("*.jpg")) == []
