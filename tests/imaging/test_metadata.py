"""What image files say of themselves, as other programs read it."""

from __future__ import annotations

import io

import cv2
import numpy as np
import pytest
from PIL import Image as Pictures

from sunarc.imaging.metadata import embedded_document, jpeg_with, png_with

DOCUMENT = {
    "schema": "sunarc.image/1",
    "time_utc": "2013-05-13T18:30:00.1234Z",
    "sun": {"azimuth": 178.1},
    "site": "Ünye",
}
IMAGE = np.arange(60_000, dtype=np.uint16).reshape(200, 300)


def encoded(suffix: str, image: np.ndarray) -> bytes:
    done, buffer = cv2.imencode(suffix, image)
    assert done
    return buffer.tobytes()


@pytest.fixture
def png() -> bytes:
    return png_with(encoded(".png", IMAGE), DOCUMENT, software="sunarc 1.2", created="2013-05-13T18:30:00Z")


@pytest.fixture
def jpeg() -> bytes:
    return jpeg_with(encoded(".jpg", (IMAGE // 256).astype(np.uint8)), DOCUMENT)


def test_the_counts_of_a_png_are_untouched(png: bytes) -> None:
    read = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    assert read is not None
    assert np.array_equal(read, IMAGE)
    with Pictures.open(io.BytesIO(png)) as picture:
        assert np.array_equal(np.asarray(picture), IMAGE)


def test_pillow_reads_what_a_png_says(png: bytes) -> None:
    with Pictures.open(io.BytesIO(png)) as picture:
        picture.load()
        assert picture.text["Software"] == "sunarc 1.2"  # type: ignore[attr-defined]
        assert '"azimuth": 178.1' in picture.text["sunarc"]  # type: ignore[attr-defined]
        assert picture.info["gamma"] == 1.0


def test_pillow_reads_what_a_jpeg_says(jpeg: bytes) -> None:
    with Pictures.open(io.BytesIO(jpeg)) as picture:
        picture.load()
        assert b'"azimuth": 178.1' in picture.info["comment"]
        assert picture.info["jfif"]


def test_both_are_read_back_whole(png: bytes, jpeg: bytes) -> None:
    assert embedded_document(png) == DOCUMENT
    assert embedded_document(jpeg) == DOCUMENT


@pytest.mark.parametrize("cut", [0, 1, 7, 20, 60])
def test_a_file_that_was_cut_or_says_nothing_has_no_document(png: bytes, jpeg: bytes, cut: int) -> None:
    assert embedded_document(png[:cut]) is None
    assert embedded_document(jpeg[:cut]) is None
    assert embedded_document(encoded(".png", IMAGE)) is None
    assert embedded_document(encoded(".jpg", (IMAGE // 256).astype(np.uint8))) is None


def test_a_document_too_long_for_a_jpeg_is_left_away() -> None:
    plain = encoded(".jpg", np.zeros((8, 8), np.uint8))
    assert jpeg_with(plain, {"schema": "sunarc.image/1", "text": "x" * 70_000}) == plain
