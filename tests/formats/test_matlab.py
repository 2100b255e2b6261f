"""The reader of MATLAB files beside scipy's, and where scipy's would end the process."""

from __future__ import annotations

import io
import struct
import zlib

import numpy as np
import pytest
import scipy.io

from sunarc.formats.matlab import read_variables


def saved(*, compressed: bool, **content: object) -> bytes:
    target = io.BytesIO()
    scipy.io.savemat(target, content, do_compression=compressed)  # type: ignore[arg-type]
    return target.getvalue()


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kind", ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "?"])
def test_arrays_are_those_that_scipy_wrote(kind: str, *, compressed: bool) -> None:
    values = np.arange(12).reshape(3, 4).astype(kind)
    found = read_variables(saved(compressed=compressed, a=values, b={"c": values, "d": "text"}, e="x"), ("a",))
    np.testing.assert_array_equal(found["a"], values)


def test_the_members_of_a_struct_come_in_their_order() -> None:
    one, two = np.eye(3, dtype=np.uint8), np.ones((1, 1, 1, 2, 3))
    first, second = read_variables(saved(compressed=True, m={"one": one, "two": two}), ("m",))["m"]
    np.testing.assert_array_equal(first, one)
    np.testing.assert_array_equal(second, two)


def by_hand(order: str, *, numbers: int = 9, shape: tuple[int, int] = (1, 2), flags: int = 6) -> bytes:
    """Return a file with the array [[1.5, 2.5]]; `numbers` is its elements' type, `flags` its class."""
    parts = [(6, struct.pack(f"{order}II", flags, 0)), (5, struct.pack(f"{order}ii", *shape)), (1, b"a")]
    parts.append((numbers, struct.pack(f"{order}dd", 1.5, 2.5)))
    laid = b"".join(struct.pack(f"{order}II", kind, len(data)) + data + bytes(-len(data) % 8) for kind, data in parts)
    header = b"MATLAB 5.0".ljust(124) + (b"\0\1IM" if order == "<" else b"\1\0MI")
    return header + struct.pack(f"{order}II", 14, len(laid)) + laid


@pytest.mark.parametrize("order", ["<", ">"])
def test_either_order_of_bytes_is_read(order: str) -> None:
    assert np.array(read_variables(by_hand(order), ("a",))["a"]).tolist() == [[1.5, 2.5]]


@pytest.mark.parametrize("numbers", [0, 8, 14, 0x1009, 0x7F09])
def test_numbers_of_a_type_that_is_none_are_refused(numbers: int) -> None:
    with pytest.raises(ValueError, match=r"type|longer"):
        read_variables(by_hand("<", numbers=numbers), ("a",))


@pytest.mark.parametrize("change", [{"shape": (2**30, 2**30)}, {"shape": (-1, 2)}, {"flags": 0x806}, {"flags": 17}])
def test_what_is_not_two_real_numbers_is_refused(change: dict[str, int]) -> None:
    with pytest.raises(ValueError, match=r"shape|real"):
        read_variables(by_hand("<", **change), ("a",))  # type: ignore[arg-type] # one of them


def test_a_variable_that_is_missing_cut_or_too_large_is_refused() -> None:
    whole = saved(compressed=True, a=np.arange(1000.0))
    for content in (whole[:-20], whole[:200], whole[:128], b"", saved(compressed=True, b=1.0)):
        with pytest.raises(ValueError, match=r".+"):
            read_variables(content, ("a",))
    bomb = zlib.compress(bytes(2**20), 9)
    for _ in range(2):  # compressed within compressed is no array
        bomb = struct.pack("<II", 15, len(bomb)) + bomb
    with pytest.raises(ValueError, match=r".+"):
        read_variables(whole[:128] + bomb, ("a",))
