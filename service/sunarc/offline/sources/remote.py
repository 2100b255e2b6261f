"""Files at an address of fsspec: S3, HTTP, SFTP, memory and others, also archives there (`zip::s3://…`)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

from sunarc.errors import InputError, OutsideError
from sunarc.extras import extra_module
from sunarc.offline.sources.values import SourceFile

_STAMPS = ("ETag", "etag", "checksum", "mtime", "LastModified", "last_modified", "created", "CRC")
"""What file systems say of a file that changes with its content, the surest first."""


@dataclass(frozen=True, slots=True)
class Remote:
    """The files below an address; see `ImageSource`."""

    address: str

    def files(self) -> Iterator[SourceFile]:
        """Yield all files below it."""
        system, root = _opened(self.address)
        try:
            found: dict[str, dict[str, Any]] = system.find(root, detail=True)
        except (OSError, ValueError) as error:
            raise OutsideError(f"{self.address} could not be listed: {error}") from error
        for path in sorted(found):
            info = found[path]
            stamp = next((str(info[name]) for name in _STAMPS if info.get(name) is not None), "")
            yield SourceFile(path.removeprefix(root).lstrip("/"), int(info.get("size") or 0), stamp)

    def read(self, name: str) -> bytes:
        """Return a file's content."""
        system, root = _opened(self.address)
        return bytes(system.cat_file(f"{root.rstrip('/')}/{name}"))

    def path(self, name: str) -> None:
        """Return None: it is elsewhere."""
        del name


@cache
def _opened(address: str) -> tuple[Any, str]:
    core = extra_module("fsspec.core", extra="remote")
    try:
        system, root = core.url_to_fs(address)
    except (ImportError, ValueError, OSError) as error:
        raise InputError(
            field=address, problem=f"cannot be opened ({error})", remedy="install the fsspec package of this address"
        ) from None
    return system, str(root)
