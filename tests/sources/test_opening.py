"""The same files in a folder, a zip, a tar and at an fsspec address: the same names and contents."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import fsspec
import pytest
from tests.fixtures.packed_archives import contents, folder_of, tar_of, zip_of

from sunarc.common.errors import InputError
from sunarc.sources.sources import open_source


def in_memory(folder: Path) -> str:
    root = f"/{folder.name}"
    for name, content in contents().items():
        fsspec.filesystem("memory").pipe_file(f"{root}/{name}", content)
    return f"memory://{root}"


KINDS: dict[str, Callable[[Path], object]] = {
    "folder": lambda folder: folder_of(contents(), folder / "images"),
    "zip": lambda folder: zip_of(contents(), folder / "images.zip"),
    "tar": lambda folder: tar_of(contents(), folder / "images.tar"),
    "tar.gz": lambda folder: tar_of(contents(), folder / "images.tar.gz", "gz"),
    "fsspec memory": in_memory,
    "fsspec local": lambda folder: f"file://{folder_of(contents(), folder / 'images')}",
    "fsspec zip": lambda folder: f"zip://::file://{zip_of(contents(), folder / 'images.zip')}",
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_lists_and_reads_the_same_files(kind: str, tmp_path: Path) -> None:
    source = open_source(str(KINDS[kind](tmp_path)))
    files = list(source.files())
    assert [file.name for file in files] == sorted(contents())
    assert [file.size for file in files] == [len(contents()[file.name]) for file in files]
    assert {file.name: source.read(file.name) for file in files} == contents()


@pytest.mark.parametrize("kind", ["zip", "tar", "tar.gz"])
def test_an_archive_is_not_unpacked_to_the_disk(kind: str, tmp_path: Path) -> None:
    source = open_source(str(KINDS[kind](tmp_path)))
    before = sorted(os.walk(tmp_path))
    for file in source.files():
        source.read(file.name)
        assert source.path(file.name) is None
    assert sorted(os.walk(tmp_path)) == before


def test_a_single_file_is_a_source_of_its_own(tmp_path: Path) -> None:
    folder = folder_of(contents(), tmp_path)
    # a video or NetCDF file holds the images of a day
    (folder / "day.mp4").write_bytes(b"1")
    (folder / "day.nc").write_bytes(b"2")
    assert [(f.name, f.size) for f in open_source(str(folder / "day.mp4")).files()] == [("day.mp4", 1)]
    assert open_source(str(folder / "day.nc")).read("day.nc") == b"2"


@pytest.mark.parametrize("kind", ["folder", "zip", "fsspec local"])
def test_a_file_that_changes_has_another_stamp(kind: str, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    changed = contents() | {"notes.txt": b"NO image"}  # of the same size
    one = list(open_source(str(KINDS[kind](tmp_path / "a"))).files())
    if kind == "zip":
        other = list(open_source(str(zip_of(changed, tmp_path / "b" / "images.zip"))).files())
    else:
        folder = tmp_path / "a" / "images"
        (folder / "notes.txt").write_bytes(changed["notes.txt"])
        os.utime(folder / "notes.txt", ns=(1, 1))
        other = list(open_source(f"file://{folder}" if kind == "fsspec local" else str(folder)).files())
    stamps, new = ({file.name: (file.size, file.stamp) for file in files} for files in (one, other))
    assert {name for name in stamps if stamps[name] != new[name]} == {"notes.txt"}


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 no archive", b"plain text"])
def test_a_file_that_is_no_archive_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "images.zip"
    path.write_bytes(content)
    with pytest.raises(InputError) as refused:
        open_source(str(path))
    assert refused.value.field == str(path)


@pytest.mark.parametrize("address", ["/nowhere/at/all", "nosuchscheme://bucket/images"])
def test_an_address_where_nothing_is_is_refused(address: str) -> None:
    with pytest.raises(InputError) as refused:
        list(open_source(address).files())
    assert refused.value.field == address


def test_a_truncated_tar_is_refused(tmp_path: Path) -> None:
    path = tar_of({"a.png": b"x" * 5000, "b.png": b"y" * 5000}, tmp_path / "images.tar")
    path.write_bytes(path.read_bytes()[:7000])
    with pytest.raises(InputError) as refused:
        list(open_source(str(path)).files())
    assert refused.value.field == str(path)


def test_a_file_that_is_not_in_the_archive_cannot_be_read(tmp_path: Path) -> None:
    for source in (zip_of(contents(), tmp_path / "a.zip"), tar_of(contents(), tmp_path / "a.tar")):
        with pytest.raises(OSError):  # noqa: PT011 - of two libraries
            open_source(str(source)).read("b.png")


def test_a_file_of_a_zip_whose_checksum_is_wrong_cannot_be_read(tmp_path: Path) -> None:
    path = zip_of({"a.png": bytes(range(256)) * 9, "b.png": b"whole"}, tmp_path / "images.zip")
    content = bytearray(path.read_bytes())
    content[60] ^= 0xFF
    path.write_bytes(bytes(content))
    source = open_source(str(path))
    with pytest.raises(OSError, match="CRC"):
        source.read("a.png")
    assert source.read("b.png") == b"whole"
