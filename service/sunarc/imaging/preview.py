"""Pictures: the pixels of a file's content, colours of a mosaic, an 8-bit image for people to see."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.common.array_types import Image
from sunarc.detection.values import Bayer

_PNG = b"\x89PNG\r\n\x1a\n"
_KNEE = 300.0  # how strongly the logarithm lifts the dark

# OpenCV names a mosaic by the second row's second and third pixel
_CODES: dict[Bayer, int] = {
    "RGGB": cv2.COLOR_BayerRGGB2BGR,
    "BGGR": cv2.COLOR_BayerBGGR2BGR,
    "GRBG": cv2.COLOR_BayerGRBG2BGR,
    "GBRG": cv2.COLOR_BayerGBRG2BGR,
}


def decoded(encoded: bytes, flags: int = cv2.IMREAD_UNCHANGED) -> NDArray[Any] | None:
    """Return the pixels of an image file's content, as `cv2.imdecode` does; None where it cannot be decoded.

    Parameters
    ----------
    encoded : content of the file.
    flags : of `cv2.imdecode`.
    """
    if not encoded or (encoded.startswith(_PNG) and not _chunks_are_whole(encoded)):
        return None
    try:
        return cv2.imdecode(np.frombuffer(encoded, dtype=np.uint8), flags)
    except cv2.error:  # sizes that its header states
        return None


def _chunks_are_whole(png: bytes) -> bool:
    """Return whether all chunks are within the file; for one that says to be longer the decoder takes gigabytes."""
    at, kind = len(_PNG), b""
    while at + 12 <= len(png) and kind != b"IEND":
        kind = png[at + 4 : at + 8]
        at += 12 + int.from_bytes(png[at : at + 4], "big")
    return kind == b"IEND" and at <= len(png)


def demosaiced(image: Image, bayer: Bayer) -> Image:
    """Return the colours (rows, columns, 3) of a mosaic (rows, columns), blue, green, red, interpolated bilinearly."""
    colours = cv2.cvtColor(image, _CODES[bayer])
    return colours.astype(np.uint8) if image.dtype == np.uint8 else colours.astype(np.uint16)


def preview(image: Image, *, bayer: Bayer | None = None, white_percentile: float = 99.5) -> NDArray[np.uint8]:
    """Return a tone-mapped 8-bit image.

    Parameters
    ----------
    image : (rows, columns) uint8 or uint16, linear.
    bayer : its mosaic; the answer is then (rows, columns, 3) in OpenCV's order blue, green, red.
    white_percentile : the level shown white.

    Returns
    -------
    uint8, logarithmic between black and white. An image without light stays black.
    """
    light = image if bayer is None else demosaiced(image, bayer)
    white = float(np.percentile(light[::4, ::4], white_percentile))
    if white <= 0.0:
        return np.zeros(light.shape, dtype=np.uint8)
    levels = np.arange(np.iinfo(image.dtype).max + 1, dtype=np.float64)
    table = 255.0 * np.log1p(_KNEE * np.minimum(levels / white, 1.0)) / np.log1p(_KNEE)
    return np.asarray(np.rint(table).astype(np.uint8)[light])
