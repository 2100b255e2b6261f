"""Packed pixels, against a reading of the standards bit by bit."""

from __future__ import annotations

import numpy as np
import pytest

from sunarc.imager.cameras.frame import largest_count
from sunarc.imager.cameras.packed import pack, packed_bytes, packed_layout, unpack

FORMATS = ["Mono10p", "Mono12p", "Mono10Packed", "Mono12Packed"]


def places(pixel_format: str, pixel: int) -> list[int]:
    """Return where each bit of a pixel lies, the lowest one first: 8 times the byte's number plus the bit's.

    PFNC `p`: bit k of pixel i is bit (depth i + k) of the stream, each byte filled from its lowest bit. GigE Vision
    `Packed`: of pixels A and B in three bytes, the first holds A's high 8 bits, the third B's; the second holds A's
    low bits from bit 0 on and B's from bit 4 on.
    """
    depth = int(pixel_format[4:6])
    if pixel_format.endswith("p"):
        return [depth * pixel + k for k in range(depth)]
    group, second = divmod(pixel, 2)
    low = depth - 8
    middle = [8 * (3 * group + 1) + 4 * second + k for k in range(low)]
    return middle + [8 * (3 * group + 2 * second) + k for k in range(8)]


def packed_by_bits(values: list[int], pixel_format: str) -> bytes:
    bits = np.zeros(16 * len(values) + 32, dtype=np.uint8)
    last = 0
    for pixel, value in enumerate(values):
        for k, place in enumerate(places(pixel_format, pixel)):
            bits[place] = value >> k & 1
    last = packed_bytes(packed_layout(pixel_format) or "", len(values))
    return np.packbits(bits, bitorder="little").tobytes()[:last]


@pytest.mark.parametrize("pixel_format", FORMATS)
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 7, 8, 997])
def test_packed_pixels_are_those_of_the_standard_s_bits(pixel_format: str, count: int) -> None:
    full_scale = largest_count(pixel_format)
    values = np.random.default_rng(count).integers(0, full_scale + 1, count)
    packing = packed_layout(pixel_format)
    assert packing is not None
    data = packed_by_bits(values.tolist(), pixel_format)
    assert unpack(data + b"\xff\xff", packing, count).tolist() == values.tolist()
    assert pack(values.astype(np.uint16), packing) == data


def test_known_bytes_of_the_standards() -> None:
    assert unpack(bytes([0xAB, 0x6C, 0xDE]), "12Packed", 2).tolist() == [0xABC, 0xDE6]
    assert unpack(bytes([0xBC, 0x6A, 0xDE]), "12p", 2).tolist() == [0xABC, 0xDE6]
    assert unpack(bytes([0xFF, 0x21, 0x80]), "10Packed", 2).tolist() == [0x3FD, 0x202]


@pytest.mark.parametrize(
    ("pixel_format", "packing"),
    [("Mono12p", "12p"), ("BayerRG12Packed", "12Packed"), ("BayerGB10p", "10p"), ("Mono12", None), ("Mono8", None)],
)
def test_packed_formats_are_known_by_their_names(pixel_format: str, packing: str | None) -> None:
    assert packed_layout(pixel_format) == packing


@pytest.mark.parametrize(("pixel_format", "full_scale"), [("Mono10Packed", 1023), ("BayerRG12p", 4095)])
def test_the_full_scale_is_that_of_the_depth(pixel_format: str, full_scale: int) -> None:
    assert largest_count(pixel_format) == full_scale
