"""Azimuth and zenith angle of every pixel: two images of 16 bits, FITS and MATLAB.

References: `JP2CalibrationLoader` of https://github.com/eurocontrol-asu/skycam (azimuth_NAME.jp2 and zenith_NAME.jp2: a
circle in 64,000 steps, a right angle in 64,000); the FITS standard 4.0, sections 3.3, 4.2 and 5.3.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.answers.direction_table import BackProjectionMap
from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError
from sunarc.formats.matlab import matlab_bytes, read_variables
from sunarc.formats.tables import require_directions
from sunarc.formats.view import View, grid_view
from sunarc.imaging.preview import decoded
from sunarc.sky.directions import direction_from_angles

STEPS = 64_000
"""Of a circle of azimuth, and of a right angle of zenith."""
OUTSIDE = 65_535
"""Of both images, where a pixel looks below the horizon or outside the camera's field."""

_LOSSLESS = {".png": [], ".jp2": [cv2.IMWRITE_JPEG2000_COMPRESSION_X1000, 1000]}
_BLOCK, _CARD = 2880, 80


def sixteen_bit_files(found: BackProjectionMap, *, suffix: str) -> dict[str, bytes]:
    """Return azimuth_visible and zenith_visible as images of 16 bits, `.png` or `.jp2` (lossless)."""
    with np.errstate(invalid="ignore"):
        above = found.zenith_deg <= 90.0
    azimuth = np.mod(np.rint(found.azimuth_deg * (STEPS / 360.0)), STEPS)
    raw = {
        "azimuth": azimuth,
        "zenith": found.zenith_deg * (STEPS / 90.0),
    }
    return {
        f"{name}_visible{suffix}": _encode_image(np.where(above, np.rint(values), OUTSIDE).astype(np.uint16), suffix)
        for name, values in raw.items()
    }


def _encode_image(image: NDArray[np.uint16], suffix: str) -> bytes:
    return cv2.imencode(suffix, image, _LOSSLESS[suffix])[1].tobytes()


def read_sixteen_bit(content: bytes, *, name: str, beside: Callable[[str], bytes | None]) -> View:
    """Return the view of two images of 16 bits, of which one is given and the other is in the same folder."""
    kind, other = ("azimuth", "zenith") if name.startswith("azimuth_") else ("zenith", "azimuth")
    second = beside(name.replace(f"{kind}_", f"{other}_", 1)) if name.startswith(f"{kind}_") else None
    if second is None:
        raise InputError(
            field=name, problem="not one of a pair azimuth_NAME, zenith_NAME", remedy="keep both in one folder"
        )
    images = {kind: _decode_image(content, name), other: _decode_image(second, name)}
    if images["azimuth"].shape != images["zenith"].shape:
        raise InputError(field=name, problem="azimuth and zenith are of different sizes", remedy="write them again")
    zenith = np.where(images["zenith"] <= STEPS, images["zenith"] * (90.0 / STEPS), np.nan)
    return _angle_view(f"azimuth-zenith-{name[-3:]}", images["azimuth"] * (360.0 / STEPS), zenith, name=name)


def _decode_image(content: bytes, name: str) -> FloatArray:
    image = decoded(content)
    if image is None or image.dtype != np.uint16 or image.ndim != 2:
        raise InputError(field=name, problem="no grey image of 16 bits", remedy="give azimuth_NAME and zenith_NAME")
    return image.astype(np.float64)


def matlab_file(found: BackProjectionMap, notes: list[str]) -> bytes:
    """Return a MATLAB file (version 5) with azimuth, zenith, elevation and sigma in degrees, (height, width)."""
    angles = {"azimuth": found.azimuth_deg, "zenith": found.zenith_deg, "elevation": 90.0 - found.zenith_deg}
    return matlab_bytes(angles | {"sigma": found.sigma_deg, "notes": "\n".join(notes)})


def read_matlab(content: bytes, *, name: str) -> View:
    """Return the view of a MATLAB file with `azimuth` and `zenith` in degrees."""
    try:
        found = read_variables(content, ("azimuth", "zenith"))
        azimuth, zenith = (np.asarray(found[key], dtype=np.float64) for key in ("azimuth", "zenith"))
    except (ValueError, TypeError) as error:
        problem = f"no azimuth and zenith of MATLAB's version 5 ({error})"
        raise InputError(field=name, problem=problem, remedy="give a file of sunarc export") from None
    return _angle_view("matlab", azimuth, zenith, name=name)


def fits_file(found: BackProjectionMap, notes: list[str]) -> bytes:
    """Return a FITS file: azimuth first, zenith, elevation and sigma as image extensions; degrees, top row first."""
    layers = {"AZIMUTH": found.azimuth_deg, "ZENITH": found.zenith_deg, "ELEVATION": 90.0 - found.zenith_deg}
    units = [
        _make_fits_unit(name, values, notes, first=name == "AZIMUTH")
        for name, values in (layers | {"SIGMA": found.sigma_deg}).items()
    ]
    return b"".join(units)


def _make_fits_unit(name: str, values: NDArray[Any], notes: list[str], *, first: bool) -> bytes:
    height, width = values.shape
    kind = "SIMPLE  =                    T" if first else "XTENSION= 'IMAGE   '"
    numbers = {"BITPIX": -32, "NAXIS": 2, "NAXIS1": width, "NAXIS2": height}
    cards = [kind, *(f"{key:8}= {value:20d}" for key, value in numbers.items())]
    cards += ["EXTEND  =                    T"] if first else [f"{'PCOUNT':8}= {0:20d}", f"{'GCOUNT':8}= {1:20d}"]
    cards += [f"EXTNAME = '{name:8}'", "BUNIT   = 'deg     '"]
    text = [note.encode("ascii", "replace").decode() for note in notes] if first else []
    cards += [f"COMMENT {line[k : k + 72]}" for line in text for k in range(0, len(line), 72)]
    header = "".join(f"{card:{_CARD}}" for card in [*cards, "END"]).encode()
    return _pad_block(header, b" ") + _pad_block(values.astype(">f4").tobytes(), b"\0")


def _pad_block(content: bytes, fill: bytes) -> bytes:
    return content + fill * (-len(content) % _BLOCK)


def read_fits(content: bytes, *, name: str) -> View:
    """Return the view of a FITS file whose first two images are AZIMUTH and ZENITH, 32 bit floats in degrees."""
    layers: dict[str, FloatArray] = {}
    place = 0
    try:
        while place < len(content) and len(layers) < 2:
            cards, place = _read_fits_header(content, place)
            width, height = int(cards["NAXIS1"]), int(cards["NAXIS2"])
            if cards["BITPIX"] != "-32":
                raise KeyError("BITPIX = -32")  # noqa: TRY301 - one message for all that is missing
            values = np.frombuffer(content, dtype=">f4", count=width * height, offset=place).reshape(height, width)
            layers[cards["EXTNAME"].strip("' ")] = values.astype(np.float64)
            place += math.ceil(values.nbytes / _BLOCK) * _BLOCK
        azimuth, zenith = layers["AZIMUTH"], layers["ZENITH"]
    except (KeyError, ValueError, UnicodeDecodeError) as error:
        problem = f"no AZIMUTH and ZENITH of FITS ({error})"
        raise InputError(field=name, problem=problem, remedy="give a file of sunarc export") from None
    return _angle_view("fits", azimuth, zenith, name=name)


def _read_fits_header(content: bytes, place: int) -> tuple[dict[str, str], int]:
    """Return the keywords of a header that begins at a place, and where its data begin."""
    cards: dict[str, str] = {}
    for start in range(place, len(content), _CARD):
        card = content[start : start + _CARD].decode("ascii")
        if card.rstrip() == "END":
            return cards, place + math.ceil((start + _CARD - place) / _BLOCK) * _BLOCK
        cards[card[:8].strip()] = card[10:].partition("/")[0].strip()
    raise ValueError("no END")


def _angle_view(form: str, azimuth_deg: FloatArray, zenith_deg: FloatArray, *, name: str) -> View:
    """Return the view of two maps; NaN is taken as outside the field."""
    if azimuth_deg.ndim != 2 or azimuth_deg.shape != zenith_deg.shape:
        raise InputError(field=name, problem="azimuth and zenith are of different sizes", remedy="write them again")
    directions = direction_from_angles(zenith_deg=zenith_deg, azimuth_deg=azimuth_deg)
    height, width = zenith_deg.shape
    require_directions(directions, (height, width), name=name)
    return grid_view(form, size=(width, height), x=np.arange(width), y=np.arange(height), directions=directions)
