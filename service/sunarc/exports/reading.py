"""Files of any format that is read, recognised by what they contain."""

from __future__ import annotations

import json
from collections.abc import Callable

from sunarc.calibration import from_document
from sunarc.errors import InputError
from sunarc.exports.asi_core import mask_file, read_asi_core
from sunarc.exports.mrcal import read_mrcal
from sunarc.exports.ocamcalib import read_ocamcalib
from sunarc.exports.opencv import read_opencv
from sunarc.exports.tables import read_table
from sunarc.exports.view import View, camera_view

Beside = Callable[[str], bytes | None]
"""Returns a file that another one names, None where it is not there."""

READ_FORMATS = ("json", "opencv", "ocamcalib", "asi-core", "mrcal", "netcdf", "npz")

_BY_CONTENT: tuple[tuple[bytes, Callable[..., View]], ...] = (
    (b"internal_calibration", read_asi_core),
    (b"LENSMODEL_", read_mrcal),
    (b"polynomial coefficients for the DIRECT mapping", read_ocamcalib),
    (b"%YAML", read_opencv),
    (b"opencv_storage", read_opencv),
    (b"<?xml", read_opencv),
)


def read_view(content: bytes, *, name: str, beside: Beside = lambda _: None) -> View:
    """Return the view of a camera that a file of any format holds (`READ_FORMATS`).

    Raises
    ------
    InputError
        The format is unknown, or the file is not what its format says.
    """
    if content.startswith((b"PK", b"\x89HDF")):
        return read_table(content, name=name)
    for mark, read in _BY_CONTENT:
        if mark in content:
            if read is read_asi_core:
                called = mask_file(content)
                return read_asi_core(content, name=name, mask=None if called is None else beside(called))
            return read(content, name=name)
    try:
        document = json.loads(content)
    except ValueError:
        known = ", ".join(READ_FORMATS)
        raise InputError(field=name, problem="of no format that is read", remedy=f"give one of {known}") from None
    return camera_view(from_document(document).camera)
