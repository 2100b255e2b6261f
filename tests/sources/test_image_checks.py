"""Image files that cannot be measured in are refused, each with its code."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from sunarc.common.array_types import Image as Pixels
from sunarc.common.findings import FindingError
from sunarc.sources.image_files import checked_image, exif_orientation, image_size
from sunarc.sources.source_files import read_content
from sunarc.sources.sources import Folder

ROWS, COLUMNS = 48, 64
GREY: np.ndarray[Any, np.dtype[np.uint8]] = np.random.default_rng(5).integers(0, 255, (ROWS, COLUMNS)).astype(np.uint8)
COLOURS = np.stack([GREY, GREY // 2, GREY // 3], axis=-1)
DEEP = GREY.astype(np.uint16) * 257
ORIENTATION = 0x0112


def read_checked_image(path: Path, *, size: tuple[int, int] | None = None) -> Pixels:
    return checked_image(read_content(Folder(str(path.parent)), path.name), path.name, size=size)


def code_of(path: Path, **more: Any) -> str:  # noqa: ANN401 - as the function's
    with pytest.raises(FindingError) as refused:
        read_checked_image(path, **more)
    return refused.value.finding.code


def with_alpha(image: np.ndarray[Any, Any], *, transparent: int) -> np.ndarray[Any, Any]:
    alpha = np.full(image.shape[:2], np.iinfo(image.dtype).max, dtype=image.dtype)
    alpha.ravel()[:transparent] = 0
    return np.dstack([image, image, image, alpha])


@pytest.mark.parametrize(("name", "image"), [("a.png", GREY), ("a.png", COLOURS), ("a.png", DEEP), ("a.tif", DEEP)])
def test_a_whole_image_is_read_as_it_is(tmp_path: Path, name: str, image: np.ndarray[Any, Any]) -> None:
    path = tmp_path / name
    cv2.imwrite(str(path), image)
    read = read_checked_image(path, size=(COLUMNS, ROWS))
    assert read.dtype == image.dtype
    np.testing.assert_array_equal(read, image)
    assert image_size(Folder(str(path.parent)), path.name) == (COLUMNS, ROWS)


def test_a_jpeg_is_read_in_colours(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.jpg"), cv2.GaussianBlur(COLOURS, (9, 9), 0))
    assert read_checked_image(tmp_path / "a.jpg").shape == (ROWS, COLUMNS, 3)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.99])
def test_a_truncated_image_is_not_filled_up(tmp_path: Path, suffix: str, share: float) -> None:
    whole = cv2.imencode(suffix, COLOURS)[1].tobytes()
    path = tmp_path / f"a{suffix}"
    path.write_bytes(whole[: int(share * len(whole))])
    assert code_of(path) in {"file_truncated", "file_not_image"}


def test_the_end_of_a_thumbnail_is_not_that_of_its_image(tmp_path: Path) -> None:
    whole = cv2.imencode(".jpg", COLOURS)[1].tobytes()
    thumbnail = cv2.imencode(".jpg", GREY[:8, :8])[1].tobytes()
    segment = b"\xff\xe3" + (len(thumbnail) + 2).to_bytes(2, "big") + thumbnail
    path = tmp_path / "a.jpg"
    path.write_bytes(whole[:2] + segment + whole[2:])
    assert read_checked_image(path).shape == (ROWS, COLUMNS, 3)
    path.write_bytes((whole[:2] + segment + whole[2:])[:-40])
    assert code_of(path) == "file_truncated"


def test_bytes_after_the_end_of_an_image_are_no_fault(tmp_path: Path) -> None:
    for suffix in (".jpg", ".png"):
        path = tmp_path / f"a{suffix}"
        path.write_bytes(cv2.imencode(suffix, COLOURS)[1].tobytes() + b"\0" * 100)
        assert read_checked_image(path).shape == (ROWS, COLUMNS, 3)


def animated_png(path: Path) -> None:
    frames = [Image.fromarray(GREY), Image.fromarray(255 - GREY)]
    frames[0].save(path, save_all=True, append_images=frames[1:])


def pages(path: Path) -> None:
    Image.fromarray(GREY).save(path, format="TIFF", save_all=True, append_images=[Image.fromarray(GREY)])


def for_print(path: Path) -> None:
    Image.fromarray(COLOURS).convert("CMYK").save(path, format="JPEG")


def gif(path: Path) -> None:
    Image.fromarray(GREY).save(path, format="GIF")


@pytest.mark.parametrize(
    ("name", "write", "code"),
    [
        ("a.png", animated_png, "file_animated"),
        ("a.tif", pages, "file_animated"),
        ("a.jpg", for_print, "file_cmyk"),
        ("a.jpg", gif, "file_not_image"),
        ("a.png", lambda path: path.write_bytes(b""), "file_not_image"),
        ("a.png", lambda path: path.mkdir(), "file_not_image"),
        ("a.tif", lambda path: cv2.imwrite(str(path), GREY.astype(np.float32)), "file_not_image"),
    ],
)
def test_what_is_no_single_image_of_light_is_refused(
    tmp_path: Path, name: str, write: Callable[[Path], object], code: str
) -> None:
    write(tmp_path / name)
    assert code_of(tmp_path / name) == code


@pytest.mark.parametrize("image", [GREY, DEEP])
def test_a_transparent_image_is_refused_and_an_opaque_one_is_read(tmp_path: Path, image: np.ndarray[Any, Any]) -> None:
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), with_alpha(image, transparent=1))
    assert code_of(path) == "file_transparent"
    cv2.imwrite(str(path), with_alpha(image, transparent=0))
    np.testing.assert_array_equal(read_checked_image(path)[..., 0], image)


@pytest.mark.parametrize("orientation", [2, 3, 6, 8])
@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_an_image_is_read_as_it_is_stored_whatever_exif_states(tmp_path: Path, suffix: str, orientation: int) -> None:
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    path = tmp_path / f"a{suffix}"
    smooth = cv2.GaussianBlur(GREY, (9, 9), 0)
    Image.fromarray(smooth).save(path, exif=exif)
    assert float(np.abs(read_checked_image(path).astype(int) - smooth).mean()) < 2.0
    assert exif_orientation(Folder(str(tmp_path)), path.name) == orientation


def test_an_upright_image_that_says_so_is_read(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[ORIENTATION] = 1
    Image.fromarray(GREY).save(tmp_path / "a.png", exif=exif)
    np.testing.assert_array_equal(read_checked_image(tmp_path / "a.png"), GREY)


def test_another_size_is_refused_with_both_sizes(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), GREY)
    with pytest.raises(FindingError) as refused:
        read_checked_image(tmp_path / "a.png", size=(COLUMNS + 1, ROWS))
    assert refused.value.finding.data == {
        "width": COLUMNS, "height": ROWS, "camera_width": COLUMNS + 1, "camera_height": ROWS
    }  # fmt: skip


def test_the_size_of_what_is_no_image_is_none(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_text("no")
    assert [image_size(Folder(str(tmp_path)), name) for name in ("a.png", "b.png")] == [None, None]
