"""Packed pixel formats: two pixels of 12 bits in three bytes, and their kin.

Layouts from EMVA's "GenICam Pixel Format Naming Convention" (PFNC; the `p` formats, lowest bit first, without gaps)
and AIA's "GigE Vision", version 1.2, chapter 26 (the `Packed` formats, which keep the high bits of a pixel in one byte
and share a byte for the low bits of two). Lines follow one another without padding; the last byte may be filled up.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Words = NDArray[np.uint16]

_PACKED = re.compile(r"(?:Mono|Bayer(?:RG|BG|GR|GB))(10|12)(p|Packed)")


def packed_layout(pixel_format: str) -> str | None:
    """Return the layout of a packed format ("10p", "12p", "10Packed", "12Packed"); None of an unpacked one."""
    match = _PACKED.fullmatch(pixel_format)
    return None if match is None else match.group(1) + match.group(2)


def packed_bytes(packing: str, count: int) -> int:
    """Return how many bytes a number of pixels takes."""
    bits = 10 if packing == "10p" else 12  # GigE Vision's 10 bit format takes 12 as well
    return (bits * count + 7) // 8


def unpack(data: bytes, packing: str, count: int) -> Words:
    """Return the counts of packed pixels.

    Parameters
    ----------
    data : at least `packed_bytes` of them.
    packing : as `packed_layout` returns it.
    count : number of pixels.

    Returns
    -------
    (count,) counts, in the low bits.
    """
    per_group, group_bytes, decode, _ = _LAYOUTS[packing]
    groups = -(-count // per_group)
    raw = np.zeros(groups * group_bytes, dtype=np.uint8)
    present = packed_bytes(packing, count)
    raw[:present] = np.frombuffer(data, np.uint8, present)
    pixels = np.empty((groups, per_group), dtype=np.uint16)
    decode(raw.reshape(groups, group_bytes), pixels)
    return pixels.ravel()[:count]


def pack(image: Words, packing: str) -> bytes:
    """Return counts as the bytes of a packed format: the inverse of `unpack`."""
    per_group, group_bytes, _, encode = _LAYOUTS[packing]
    groups = -(-image.size // per_group)
    pixels = np.zeros(groups * per_group, dtype=np.uint16)
    pixels[: image.size] = image.ravel()
    raw = np.empty((groups, group_bytes), dtype=np.uint8)
    encode(pixels.reshape(groups, per_group), raw)
    return raw.tobytes()[: packed_bytes(packing, image.size)]


def _decode_12p(raw: Bytes, pixels: Words) -> None:
    middle = raw[:, 1].astype(np.uint16)
    pixels[:, 0] = raw[:, 0] | (middle & 0x0F) << 8
    pixels[:, 1] = middle >> 4 | raw[:, 2].astype(np.uint16) << 4


def _encode_12p(pixels: Words, raw: Bytes) -> None:
    raw[:, 0] = pixels[:, 0] & 0xFF
    raw[:, 1] = pixels[:, 0] >> 8 | (pixels[:, 1] & 0x0F) << 4
    raw[:, 2] = pixels[:, 1] >> 4


def _decode_12packed(raw: Bytes, pixels: Words) -> None:
    low = raw[:, 1].astype(np.uint16)
    pixels[:, 0] = raw[:, 0].astype(np.uint16) << 4 | low & 0x0F
    pixels[:, 1] = raw[:, 2].astype(np.uint16) << 4 | low >> 4


def _encode_12packed(pixels: Words, raw: Bytes) -> None:
    raw[:, 0], raw[:, 2] = pixels[:, 0] >> 4, pixels[:, 1] >> 4
    raw[:, 1] = pixels[:, 0] & 0x0F | (pixels[:, 1] & 0x0F) << 4


def _decode_10packed(raw: Bytes, pixels: Words) -> None:
    low = raw[:, 1].astype(np.uint16)
    pixels[:, 0] = raw[:, 0].astype(np.uint16) << 2 | low & 0x03
    pixels[:, 1] = raw[:, 2].astype(np.uint16) << 2 | low >> 4 & 0x03


def _encode_10packed(pixels: Words, raw: Bytes) -> None:
    raw[:, 0], raw[:, 2] = pixels[:, 0] >> 2, pixels[:, 1] >> 2
    raw[:, 1] = pixels[:, 0] & 0x03 | (pixels[:, 1] & 0x03) << 4


def _decode_10p(raw: Bytes, pixels: Words) -> None:
    words = raw.astype(np.uint16)
    for i in range(4):  # pixel i begins 2 i bits into byte i
        pixels[:, i] = (words[:, i] >> 2 * i | words[:, i + 1] << 8 - 2 * i) & 0x3FF


def _encode_10p(pixels: Words, raw: Bytes) -> None:
    raw[:, 0] = pixels[:, 0] & 0xFF
    for i in range(1, 4):
        raw[:, i] = (pixels[:, i - 1] >> 10 - 2 * i | pixels[:, i] << 2 * i) & 0xFF
    raw[:, 4] = pixels[:, 3] >> 2


_LAYOUTS = {
    "12p": (2, 3, _decode_12p, _encode_12p),
    "12Packed": (2, 3, _decode_12packed, _encode_12packed),
    "10Packed": (2, 3, _decode_10packed, _encode_10packed),
    "10p": (4, 5, _decode_10p, _encode_10p),
}
"""Pixels and bytes of a group, and its decoder and encoder of an array of groups."""
