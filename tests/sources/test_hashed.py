"""Files are hashed as they are read, and the last one is read once."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from tests.fixtures.packed_archives import contents, folder_of, zip_of

from sunarc.sources.sources import HashedSource, open_source


@pytest.mark.parametrize("make", [folder_of, lambda files, path: zip_of(files, path / "images.zip")])
def test_content_and_hash_are_those_of_the_file(make: object, tmp_path: Path) -> None:
    source = HashedSource(open_source(str(make(contents(), tmp_path))))  # type: ignore[operator]
    assert [file.name for file in source.files()] == sorted(contents())
    for name, content in contents().items():
        assert source.content(name) is None
        assert source.read(name) == content
        assert source.content(name) == hashlib.blake2b(content, digest_size=16).hexdigest()


def test_the_last_file_is_read_once(tmp_path: Path) -> None:
    name, other = sorted(contents())[:2]
    source = HashedSource(open_source(str(folder_of(contents(), tmp_path))))
    path = source.path(name)
    assert path is not None
    assert source.address == str(tmp_path)
    source.read(name)
    path.write_bytes(b"changed")
    assert source.read(name) == contents()[name]
    source.read(other)
    assert source.read(name) == b"changed"


def test_a_file_that_cannot_be_read_has_no_hash(tmp_path: Path) -> None:
    source = HashedSource(open_source(str(folder_of(contents(), tmp_path))))
    source.read(min(contents()))
    with pytest.raises(OSError, match="gone"):
        source.read("gone.png")
    assert source.content("gone.png") is None
    assert source.content(min(contents())) is None
