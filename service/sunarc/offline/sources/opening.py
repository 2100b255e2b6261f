"""The source at an address."""

from __future__ import annotations

import tarfile
import zipfile
from pathlib import Path

from sunarc.errors import InputError
from sunarc.offline.sources.frames import kind_of
from sunarc.offline.sources.values import ImageSource


def open_source(address: str) -> ImageSource:
    """Return the source at an address: a folder, a zip or tar archive, an image file, or one of fsspec (`scheme://…`).

    Raises
    ------
    InputError : there is none, or the extra that it needs is not installed.
    """
    if "://" in address:
        from sunarc.offline.sources.remote import Remote  # noqa: PLC0415 - its library only where it is needed

        return Remote(address)
    path = Path(address)
    if path.is_dir() or (path.is_file() and kind_of(address) is not None):
        from sunarc.offline.sources.folder import Folder  # noqa: PLC0415

        return Folder(address)
    if not path.is_file():
        raise InputError(field=address, problem="is neither a folder nor a file", remedy="name a folder or an archive")
    if zipfile.is_zipfile(path):
        from sunarc.offline.sources.zip_file import ZipFile  # noqa: PLC0415

        return ZipFile(address)
    if tarfile.is_tarfile(path):
        from sunarc.offline.sources.tar_file import TarFile  # noqa: PLC0415

        return TarFile(address)
    raise InputError(
        field=address, problem="is neither a zip nor a tar archive", remedy="name a folder of images, or an archive"
    )
