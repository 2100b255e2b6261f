"""Files of any format that is read, recognised by what they contain."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np

from sunarc.calibration.model.document import from_document
from sunarc.errors import InputError
from sunarc.exports.asi_core import mask_file, read_asi_core
from sunarc.exports.mrcal import read_mrcal
from sunarc.exports.ocamcalib import read_ocamcalib
from sunarc.exports.opencv import read_opencv
from sunarc.exports.pixel_maps import read_fits, read_matlab, read_sixteen_bit
from sunarc.exports.remap import is_remap, read_remap
from sunarc.exports.tables import read_table
from sunarc.exports.text_cameras import read_colmap, read_ros
from sunarc.exports.view import View, camera_view

Beside = Callable[[str], bytes | None]
"""Returns a file that another one names, None where it is not there."""

READ_FORMATS = (
    "json",
    "opencv",
    "ocamcalib",
    "asi-core",
    "mrcal",
    "netcdf",
    "npz",
    "opencv-remap",
    "colmap",
    "ros",
    "fits",
    "matlab",
    "azimuth-zenith-png",
    "azimuth-zenith-jp2",
)

_BY_CONTENT: tuple[tuple[bytes, Callable[..., View]], ...] = (
    (b"internal_calibration", read_asi_core),
    (b"LENSMODEL_", read_mrcal),
    (b"distortion_model:", read_ros),
    (b"_FISHEYE ", read_colmap),
    (b"polynomial coefficients for the DIRECT mapping", read_ocamcalib),
    (b"%YAML", read_opencv),
    (b"opencv_storage", read_opencv),
    (b"<?xml", read_opencv),
)
_PROBED = 9
"""Pixels along a side that are asked for a direction: a fisheye shows some of them, whatever its field."""
_IMAGES = (b"\x89PNG", b"\x00\x00\x00\x0cjP  ")


def _read_npz(content: bytes, *, name: str) -> View:
    return (read_remap if is_remap(content) else read_table)(content, name=name)


_BY_START: tuple[tuple[bytes, Callable[..., View]], ...] = (
    (b"PK", _read_npz),
    (b"\x89HDF", read_table),
    (b"SIMPLE  =", read_fits),
    (b"MATLAB 5.0", read_matlab),
)


def read_view(content: bytes, *, name: str, beside: Beside = lambda _: None) -> View:
    """Return the view of a camera that a file of any format holds (`READ_FORMATS`).

    Raises
    ------
    InputError
        The format is unknown, the file is not what its format says, or no pixel of its image has a direction.
    """
    view = _view_of(content, name=name, beside=beside)
    across = [np.linspace(0.0, size - 1.0, _PROBED) for size in (view.width, view.height)]
    if not np.any(np.isfinite(view.unproject(np.stack(np.meshgrid(*across), axis=-1).reshape(-1, 2)))):
        raise InputError(
            field=name, problem="no pixel of its image has a direction", remedy="look for NaN among its numbers"
        )
    return view


def _view_of(content: bytes, *, name: str, beside: Beside) -> View:
    for start, read in _BY_START:
        if content.startswith(start):
            return read(content, name=name)
    if content.startswith(_IMAGES):
        return read_sixteen_bit(content, name=name, beside=beside)
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
