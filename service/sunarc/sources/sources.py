"""Where an archive's files are: a folder, a zip or tar archive, an address of fsspec."""

from __future__ import annotations

import atexit
import hashlib
import tarfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from lzma import LZMAError
from pathlib import Path
from stat import S_ISREG
from typing import Any, NamedTuple

from sunarc.common.errors import InputError, OutsideError
from sunarc.common.extras import extra_module
from sunarc.common.foreign_files import name_path, name_text, open_regular, read_regular
from sunarc.sources.file_kinds import find_kind
from sunarc.sources.source_files import UPRIGHT_ADDRESS, ImageSource, SourceFile, stored_address


def open_source(address: str) -> ImageSource:
    """Return the source at an address: a folder, a zip or tar archive, an image file, or one of fsspec (`scheme://…`).

    An address is the `name_text` of a path; "exif:" before it turns pictures as their EXIF orientation states.

    Raises
    ------
    InputError : it is missing, or the extra that it needs is not installed.
    """
    if address.startswith(UPRIGHT_ADDRESS):
        return UprightSource(open_source(stored_address(address)))
    if "://" in address:
        return Remote(address)
    path = Path(name_path(address))
    if path.is_dir() or (path.is_file() and find_kind(address) is not None):
        return Folder(address)
    if not path.is_file():
        raise InputError(field=address, problem="is neither a folder nor a file", remedy="name a folder or an archive")
    if zipfile.is_zipfile(path):
        return ZipFile(address)
    if tarfile.is_tarfile(path):
        return TarFile(address)
    raise InputError(
        field=address, problem="is neither a zip nor a tar archive", remedy="name a folder of images, or an archive"
    )


@dataclass(frozen=True, slots=True)
class Folder:
    """Source of the files below a folder, or of a single file; see `ImageSource`."""

    address: str

    def files(self) -> Iterator[SourceFile]:
        """Yield all files below it; stamped with the time of their last change."""
        root, folder = Path(name_path(self.address)), self._find_root
        for path in [root] if root.is_file() else sorted(root.rglob("*")):
            with suppress(OSError):  # it is gone again
                state = path.stat()
                if S_ISREG(state.st_mode):
                    yield SourceFile(name_text(path.relative_to(folder)), state.st_size, str(state.st_mtime_ns))

    def read(self, name: str) -> bytes:
        """Return a file's content."""
        return read_regular(self.path(name))

    def path(self, name: str) -> Path:
        """Return where a file is."""
        return self._find_root / name_path(name)

    @property
    def _find_root(self) -> Path:
        root = Path(name_path(self.address))
        return root.parent if root.is_file() else root


def open_folder(path: Path, *, follow_exif: bool = False) -> ImageSource:
    """Return the source of the files below a folder, which need not be there, with pictures as stored or upright."""
    folder = Folder(name_text(path))
    return UprightSource(folder) if follow_exif else folder


def upright_addresses(addresses: tuple[str, ...]) -> tuple[str, ...]:
    """Return addresses of sources whose pictures are turned as their EXIF orientation states."""
    return tuple(UPRIGHT_ADDRESS + stored_address(one) for one in addresses)


@dataclass(frozen=True, slots=True)
class UprightSource:
    """Another source, whose pictures are turned as their EXIF orientation states; see `ImageSource`."""

    source: ImageSource

    @property
    def address(self) -> str:
        """Address that `open_source` opens it by."""
        return UPRIGHT_ADDRESS + self.source.address

    def files(self) -> Iterator[SourceFile]:
        """Yield all files, in the order of their names."""
        return self.source.files()

    def read(self, name: str) -> bytes:
        """Return a file's content, as it is stored."""
        return self.source.read(name)

    def path(self, name: str) -> Path | None:
        """Return where a file is on this disk; None where it is elsewhere."""
        return self.source.path(name)


_HASH_BYTES = 16
"""Two of 1e9 files have the same hash by chance with a probability of 1e-21."""


def content_hash(content: bytes) -> str:
    """Return the hash of a file's content, 32 hexadecimal digits."""
    return hashlib.blake2b(content, digest_size=_HASH_BYTES).hexdigest()


class HashedSource:
    """Source that keeps the content and hash of the last file read from another one; see `ImageSource`."""

    def __init__(self, source: ImageSource) -> None:
        self._source = source
        self._last: tuple[str, bytes, str] | None = None

    @property
    def address(self) -> str:
        """Address that `open_source` opens the other one by."""
        return self._source.address

    def files(self) -> Iterator[SourceFile]:
        """Yield all files, in the order of their names."""
        return self._source.files()

    def read(self, name: str) -> bytes:
        """Return a file's content; that of the last file is not read again."""
        if self._last is None or self._last[0] != name:
            self._last = None  # two large files are not in memory at once
            content = self._source.read(name)
            self._last = (name, content, content_hash(content))
        return self._last[1]

    def path(self, name: str) -> Path | None:
        """Return where a file is on this disk; None where it is elsewhere."""
        return self._source.path(name)

    def content(self, name: str) -> str | None:
        """Return the hash of a file's bytes, 32 hexadecimal digits; None unless it was the last one that was read."""
        return self._last[2] if self._last is not None and self._last[0] == name else None


_STAMPS = ("ETag", "etag", "checksum", "mtime", "LastModified", "last_modified", "created", "CRC")
"""Stamps of file systems that change with a file's content, the surest first."""


@dataclass(frozen=True, slots=True)
class Remote:
    """Source of the files below an address of fsspec; see `ImageSource`."""

    address: str

    def files(self) -> Iterator[SourceFile]:
        """Yield all files below it."""
        system, root = _open_filesystem(self.address)
        try:
            found: dict[str, dict[str, Any]] = system.find(root, detail=True)
        except (OSError, ValueError) as error:
            raise OutsideError(f"{self.address} could not be listed: {error}") from error
        for path in sorted(found):
            info = found[path]
            stamp = next((str(info[name]) for name in _STAMPS if info.get(name) is not None), "")
            yield SourceFile(name_text(path.removeprefix(root).lstrip("/")), int(info.get("size") or 0), stamp)

    def read(self, name: str) -> bytes:
        """Return a file's content."""
        system, root = _open_filesystem(self.address)
        return bytes(system.cat_file(f"{root.rstrip('/')}/{name_path(name)}"))

    def path(self, name: str) -> None:
        """Return None: it is elsewhere."""
        del name


@cache
def _open_filesystem(address: str) -> tuple[Any, str]:
    core = extra_module("fsspec.core", extra="remote")
    try:
        system, root = core.url_to_fs(address)
    except (ImportError, ValueError, OSError) as error:
        raise InputError(
            field=address, problem=f"cannot be opened ({error})", remedy="install the fsspec package of this address"
        ) from None
    return system, str(root)


_FAULTS = (tarfile.TarError, zlib.error, LZMAError, EOFError)


@dataclass(frozen=True, slots=True)
class TarFile:
    """Source of the files in a tar archive; see `ImageSource`."""

    address: str

    def files(self) -> Iterator[SourceFile]:
        """Yield all files in it, stamped with the time of their last change and their place in the archive."""
        members = _open_tar(self.address).members
        for name in sorted(members):
            info = members[name]
            yield SourceFile(name, info.size, f"{info.mtime}-{info.offset}")

    def read(self, name: str) -> bytes:
        """Return a file's content."""
        opened = _open_tar(self.address)
        if name not in opened.members:
            raise FileNotFoundError(2, "is not in the archive", name)
        member = opened.members[name]
        if opened.archive is None:
            with open_regular(Path(name_path(self.address))) as file:
                file.seek(member.offset_data)
                content = file.read(member.size)
        else:
            content = _extract_member(opened.archive, member)
        if len(content) != member.size:
            raise OSError(f"the archive ends within {name}")
        return content

    def path(self, name: str) -> None:
        """Return None: it is within the archive."""
        del name


class _Opened(NamedTuple):
    """The files of an archive, and where it is compressed the open archive, which cannot be read at any place."""

    members: dict[str, tarfile.TarInfo]
    archive: tarfile.TarFile | None


def _extract_member(archive: tarfile.TarFile, member: tarfile.TarInfo) -> bytes:
    try:
        file = archive.extractfile(member)
        return b"" if file is None else file.read()
    except _FAULTS as error:
        raise OSError(f"{type(error).__name__}: {error}") from None


@cache  # the headers stand between the files: a process reads them once
def _open_tar(address: str) -> _Opened:
    for mode in ("r:", "r:*"):
        try:
            archive = tarfile.open(name_path(address), mode)  # noqa: SIM115 - closed below
        except (*_FAULTS, OSError):
            continue
        return _list_archive(address, archive, compressed=mode == "r:*")
    raise InputError(field=address, problem="is not a complete tar archive", remedy="copy it again")


def _list_archive(address: str, archive: tarfile.TarFile, *, compressed: bool) -> _Opened:
    try:
        members = {name_text(info.name): info for info in archive.getmembers() if info.isfile()}
    except (*_FAULTS, OSError) as error:
        archive.close()
        raise InputError(
            field=address, problem=f"is not a complete tar archive ({error})", remedy="copy it again"
        ) from None
    if not compressed:
        archive.close()
        return _Opened(members, None)
    atexit.register(archive.close)
    return _Opened(members, archive)


@dataclass(frozen=True, slots=True)
class ZipFile:
    """Source of the files in a zip archive; see `ImageSource`."""

    address: str

    def files(self) -> Iterator[SourceFile]:
        """Yield all files in it; stamped with the checksum of their content."""
        members = _zip_members(self.address)
        for name in sorted(members):
            yield SourceFile(name, members[name].file_size, f"{members[name].CRC:08x}")

    def read(self, name: str) -> bytes:
        """Return a file's content."""
        try:
            return _open_zip(self.address).read(_zip_members(self.address)[name])
        except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, KeyError) as error:
            raise OSError(f"{type(error).__name__}: {error}") from None

    def path(self, name: str) -> None:
        """Return None: it is within the archive."""
        del name


@cache  # the directory of a large archive takes seconds to read, and a process reads it once
def _open_zip(address: str) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(name_path(address))
    except (zipfile.BadZipFile, OSError, ValueError) as error:  # a ValueError of names that are not as it states
        raise InputError(
            field=address, problem=f"is not a complete zip archive ({error})", remedy="copy it again"
        ) from None


@cache
def _zip_members(address: str) -> dict[str, zipfile.ZipInfo]:
    return {name_text(one.filename): one for one in _open_zip(address).infolist() if not one.is_dir()}
