"""What a worker answers: one answer an image, whatever the image is."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.packed_archives import encoded, folder_of

from sunarc.common.findings import Finding
from sunarc.detection.values import Detection, Expectation
from sunarc.lab.simulation.made_archive import photograph
from sunarc.sources import look
from sunarc.sources.look import Answer, Chunk, Item, find_static_mask, look_at, result_key

SIZE = 240
RNG = np.random.default_rng(4)
SUN_PX = np.array([90.0, 130.0])
WITH_SUN = encoded(photograph(SIZE, SUN_PX, RNG), ".png")
FILES = {
    "clear.png": WITH_SUN,
    "cloudy.png": encoded(photograph(SIZE, SUN_PX, RNG, hidden=True), ".png"),
    "empty.jpg": b"",
    "small.png": encoded(np.zeros((9, 9), dtype=np.uint8), ".png"),
    "truncated.jpg": encoded(photograph(SIZE, SUN_PX, RNG), ".jpg")[:-200],
}


def answers(folder: Path, *items: Item) -> list[Answer]:
    given = items or tuple(Item(name, 0, None) for name in sorted(FILES))
    return look_at(Chunk("roof", str(folder_of(FILES, folder)), "auto", (SIZE, SIZE), given))


def test_every_image_has_an_answer_in_the_order_of_the_chunk(tmp_path: Path) -> None:
    found = {one.file: one.found for one in answers(tmp_path)}
    assert list(found) == sorted(FILES)
    codes = {name: one.code for name, one in found.items() if isinstance(one, Finding)}
    assert codes == {
        "empty.jpg": "file_not_image", "small.png": "file_size_differs", "truncated.jpg": "file_truncated",
    }  # fmt: skip
    clear = found["clear.png"]
    assert isinstance(clear, Detection)
    assert clear.accepted
    assert abs(float(clear.x_px or 0.0) - 90.0) < 1.0


@pytest.mark.parametrize(
    ("found", "verdict", "codes"),
    [(None, "hidden", ["no_round_region"]), ((90.0, 130.0), "reflection", ["blob_displaced"])],
)
def test_a_prediction_elsewhere_refuses_what_is_found(
    found: tuple[float, float] | None, verdict: str, codes: list[str], tmp_path: Path
) -> None:
    elsewhere = Expectation(x_px=200.0, y_px=40.0, uncertainty_px=1.0)
    (answer,) = answers(tmp_path, Item("clear.png", 0, None, elsewhere, found=found))
    assert isinstance(answer.found, Detection)
    assert (answer.found.accepted, answer.found.verdict) == (False, verdict)
    assert [one.code for one in answer.found.findings] == codes


def test_where_the_sun_is_outside_the_image_nothing_is_the_sun(tmp_path: Path) -> None:
    (answer,) = answers(tmp_path, Item("clear.png", 0, None, None, outside=True))
    assert isinstance(answer.found, Detection)
    assert (answer.found.verdict, [one.code for one in answer.found.findings]) == ("hidden", ["sun_outside_image"])


def test_a_detector_that_fails_costs_its_image_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> Detection:
        raise ZeroDivisionError

    monkeypatch.setattr(look, "detect_in_image", fails)
    codes = [one.found.code for one in answers(tmp_path) if isinstance(one.found, Finding)]
    assert codes.count("image_failed") == 2
    assert len(codes) == len(FILES)


def test_what_stands_still_in_a_series_is_masked(tmp_path: Path) -> None:
    pictures = {}
    for number in range(12):
        picture = photograph(SIZE, np.array([40.0 + 14.0 * number, 120.0]), RNG)
        picture[8:20, 10:90] = 255
        pictures[f"{number:02d}.png"] = encoded(picture, ".png")
    items = tuple(Item(name, 0, None) for name in pictures)
    mask = find_static_mask(Chunk("roof", str(folder_of(pictures, tmp_path)), "auto", (SIZE, SIZE), items))
    assert mask is not None
    unpacked = mask.unpacked()
    assert unpacked[12, 50]
    assert 0.0 < float(unpacked[:, 30:200][60:200].mean()) + 0.01 < 0.5


def test_a_key_is_the_same_for_the_same_parts_alone() -> None:
    item = Item("a", 0, None, Expectation(x_px=1.0, y_px=2.0))
    assert result_key(("1", item)) == result_key(("1", Item("a", 0, None, Expectation(x_px=1.0, y_px=2.0))))
    assert result_key(("1", item)) != result_key(("2", item))
    assert len(result_key(())) == 24


def test_an_image_of_the_stated_content_is_not_looked_at_again(tmp_path: Path) -> None:
    first = {one.file: one for one in answers(tmp_path)}
    assert first["clear.png"].content == hashlib.blake2b(WITH_SUN, digest_size=16).hexdigest()
    assert len({one.content for one in first.values()}) == len(FILES)
    items = [Item(name, 0, None, content=one.content) for name, one in sorted(first.items())]
    again = answers(tmp_path, *items[:-1], items[-1]._replace(content="0" * 32))
    assert [(one.file, one.found, one.content) for one in again[:-1]] == [(i.file, None, i.content) for i in items[:-1]]
    assert again[-1] == first[items[-1].file]


def test_a_file_that_is_gone_has_an_answer_that_says_so(tmp_path: Path) -> None:
    (gone,) = answers(tmp_path, Item("gone.png", 0, None, content="0" * 32))
    assert isinstance(gone.found, Finding)
    assert (gone.found.code, gone.content) == ("file_not_image", None)
