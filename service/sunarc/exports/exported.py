"""A calibration in another format, and what every file says of it."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sunarc.exports.comparison import Differences

PIXELS = "pixel (0, 0) is the centre of the top-left one, x right, y down; azimuth clockwise from north"
_ZIP_TIME = (1980, 1, 1, 0, 0, 0)
"""The earliest that a zip file can say: the same calibration always makes the same bytes."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Exported:
    """A calibration in another format.

    Attributes
    ----------
    content : the file.
    error : how far it is from the calibration, in one sentence; the file says it too.
    difference : the same in numbers; None for the calibration itself, and where nothing was compared.
    name : what the file is called in a set.
    beside : files that belong beside it, by the names that it calls them.
    """

    content: bytes
    error: str
    difference: Differences | None = None
    name: str = ""
    beside: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def files(self) -> dict[str, bytes]:
        """Return the files of a set by name."""
        return {self.name: self.content, **self.beside}

    @property
    def sent(self) -> bytes:
        """Return the one file that is sent: a set as a zip file."""
        if not self.beside:
            return self.content
        target = io.BytesIO()
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in self.files.items():
                archive.writestr(zipfile.ZipInfo(name, _ZIP_TIME), content)
        return target.getvalue()


def notes_of(document: Mapping[str, Any]) -> list[str]:
    """Return what every file says at its top: who made it of which calibration, and the conventions."""
    software = document["software"]
    return [
        f"{software['name']} {software['version']}: camera {document['camera']}, calibration {document['id']}",
        f"conventions of the service: {PIXELS}",
    ]
