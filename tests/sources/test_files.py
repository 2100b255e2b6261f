"""Files are read whole, or refused with the file as the field."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.common.errors import InputError
from sunarc.sources.files import read_file, read_image, read_lines, require_inside


def written(path: Path, image: NDArray[Any]) -> Path:
    assert cv2.imwrite(str(path), image)
    return path


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_a_lossless_image_keeps_its_depth_and_every_count(tmp_path: Path, kind: type, suffix: str) -> None:
    image: NDArray[Any] = np.random.default_rng(1).integers(0, np.iinfo(kind).max, (5, 7)).astype(kind)
    read = read_image(written(tmp_path / f"a{suffix}", image))
    assert read.dtype == kind
    np.testing.assert_array_equal(read, image)


def test_an_opaque_alpha_channel_is_dropped_and_a_transparent_image_is_refused(tmp_path: Path) -> None:
    image = np.arange(2 * 3 * 4, dtype=np.uint8).reshape(2, 3, 4)
    with pytest.raises(InputError, match="transparent"):
        read_image(written(tmp_path / "b.png", image))
    image[..., 3] = 255
    np.testing.assert_array_equal(read_image(written(tmp_path / "a.png", image)), image[..., :3])


def test_colours_are_kept(tmp_path: Path) -> None:
    image = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    np.testing.assert_array_equal(read_image(written(tmp_path / "a.png", image)), image)


def test_an_image_of_floats_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "a.tif", np.ones((4, 4), dtype=np.float32))
    with pytest.raises(InputError) as refused:
        read_image(path)
    assert refused.value.field == str(path)


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n"])
def test_an_empty_or_torn_image_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(content)
    with pytest.raises(InputError) as refused:
        read_image(path)
    assert refused.value.field == str(path)


@pytest.mark.parametrize("reader", [read_file, read_lines, read_image])
def test_a_missing_file_and_a_folder_are_refused_by_their_path(tmp_path: Path, reader: type) -> None:
    for path in (tmp_path / "absent", tmp_path):
        with pytest.raises(InputError) as refused:
            reader(path)
        assert refused.value.field == str(path)


def test_lines_lose_a_byte_order_mark_and_windows_line_ends(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(b"\xef\xbb\xbfa,b\r\n1,2\r\n")
    assert read_lines(path) == ["a,b", "1,2"]


def test_lines_of_another_encoding_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes("größe".encode("latin-1"))
    with pytest.raises(InputError) as refused:
        read_lines(path)
    assert refused.value.field == str(path)


def test_pixels_up_to_the_outer_edges_of_the_outer_pixels_are_inside() -> None:
    corners = np.array([[-0.5, -0.5], [7.5, -0.5], [-0.5, 5.5], [7.5, 5.5]])
    require_inside(corners, (8, 6), name="points.csv")


@pytest.mark.parametrize("outside", [(-1.51, 2.0), (8.51, 2.0), (2.0, -1.51), (2.0, 6.51)])
def test_many_pixels_far_beyond_an_edge_are_refused_with_the_first_one_s_number(outside: tuple[float, float]) -> None:
    inside = np.ones((18, 2))
    require_inside(np.array([[1.0, 1.0], outside, *inside]), (8, 6), name="points.csv")
    with pytest.raises(InputError) as refused:
        require_inside(np.array([[1.0, 1.0], outside, outside, *inside]), (8, 6), name="points.csv")
    assert refused.value.field.split(", ") == ["points.csv", "sighting 2"]


def test_pixels_beside_the_image_are_no_other_size() -> None:
    require_inside(np.array([[1.0, 1.0], [7.54, 2.0], [8.4, 2.0]]), (8, 6), name="points.csv")
