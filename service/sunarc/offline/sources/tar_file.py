"""The files in a tar archive, read in place; a compressed one is read from its beginning whenever it has to go back."""

from __future__ import annotations

import atexit
import tarfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from lzma import LZMAError
from pathlib import Path
from typing import NamedTuple

from sunarc.errors import InputError
from sunarc.offline.sources.values import SourceFile

_FAULTS = (tarfile.TarError, zlib.error, LZMAError, EOFError)


@dataclass(frozen=True, slots=True)
class TarFile:
    """The files in a tar archive; see `ImageSource`."""

    address: str

    def files(self) -> Iterator[SourceFile]:
        """Yield all files in it, stamped with the time of their last change and their place in the archive."""
        members = _opened(self.address).members
        for name in sorted(members):
            info = members[name]
            yield SourceFile(name, info.size, f"{info.mtime}-{info.offset}")

    def read(self, name: str) -> bytes:
        """Return a file's content."""
        opened = _opened(self.address)
        if name not in opened.members:
            raise FileNotFoundError(2, "is not in the archive", name)
        member = opened.members[name]
        if opened.archive is None:
            with Path(self.address).open("rb") as file:
                file.seek(member.offset_data)
                content = file.read(member.size)
        else:
            content = _extracted(opened.archive, member)
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


def _extracted(archive: tarfile.TarFile, member: tarfile.TarInfo) -> bytes:
    try:
        file = archive.extractfile(member)
        return b"" if file is None else file.read()
    except _FAULTS as error:
        raise OSError(f"{type(error).__name__}: {error}") from None


@cache  # the headers stand between the files: a process reads them once
def _opened(address: str) -> _Opened:
    for mode in ("r:", "r:*"):
        try:
            archive = tarfile.open(address, mode)  # noqa: SIM115 - closed below
        except (*_FAULTS, OSError):
            continue
        return _listed(address, archive, compressed=mode == "r:*")
    raise InputError(field=address, problem="is no whole tar archive", remedy="copy it again")


def _listed(address: str, archive: tarfile.TarFile, *, compressed: bool) -> _Opened:
    try:
        members = {info.name: info for info in archive.getmembers() if info.isfile()}
    except (*_FAULTS, OSError) as error:
        archive.close()
        raise InputError(field=address, problem=f"is no whole tar archive ({error})", remedy="copy it again") from None
    if not compressed:
        archive.close()
        return _Opened(members, None)
    atexit.register(archive.close)
    return _Opened(members, archive)
