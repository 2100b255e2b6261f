"""The header of a .npy file: all that numpy writes is read as numpy reads it, and nothing else breaks the reader."""

from __future__ import annotations

import io
import struct
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.lib import format as npy

from sunarc.imager.web.arrays import NpyHeader, NpyHeaderError, read_npy_header

if TYPE_CHECKING:
    from tests.fixtures.served import Made

PLAIN = [f"{order}{kind}" for order in "<>" for kind in ("f2", "f4", "f8", "i2", "i8", "u4", "c8", "c16")]
PLAIN += ["|b1", "|i1", "|u1"]


def written(version: int, descr: str, shape: tuple[int, ...], *, fortran_order: bool) -> bytes:
    """Return the header that numpy writes; its own writer of version 3 is private, and differs in one byte."""
    stream = io.BytesIO()
    write = npy.write_array_header_1_0 if version == 1 else npy.write_array_header_2_0
    write(stream, {"descr": descr, "fortran_order": fortran_order, "shape": shape})
    body = stream.getvalue()
    return body[:6] + bytes([version]) + body[7:]


def framed(text: str, version: int = 1) -> bytes:
    """Return a header of any text."""
    encoded = text.encode("utf8")
    return b"\x93NUMPY" + bytes([version, 0]) + struct.pack("<H" if version == 1 else "<I", len(encoded)) + encoded


def by_numpy(body: bytes) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    stream = io.BytesIO(body)
    version = npy.read_magic(stream)
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, fortran_order, dtype = read(stream)
    return shape, fortran_order, dtype, stream.tell()


@settings(max_examples=300, deadline=None)
@given(
    version=st.sampled_from([1, 2, 3]),
    descr=st.sampled_from(PLAIN),
    shape=st.lists(st.integers(0, 2**62), max_size=6).map(tuple),
    fortran_order=st.booleans(),
)
def test_what_numpy_writes_is_read_as_numpy_reads_it(
    version: int,
    descr: str,
    shape: tuple[int, ...],
    fortran_order: bool,  # noqa: FBT001 - drawn
) -> None:
    body = written(version, descr, shape, fortran_order=fortran_order)
    header = read_npy_header(body + b"data")
    numpys = by_numpy(body)
    assert (header.shape, header.fortran_order, header.dtype, header.offset) == numpys


@settings(max_examples=500, deadline=None)
@given(data=st.data())
def test_a_changed_header_is_read_as_numpy_reads_it_or_refused(data: st.DataObject) -> None:
    body = bytearray(written(data.draw(st.sampled_from([1, 2, 3])), "<f8", (3, 2), fortran_order=False))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(6, len(body) - 1))
        piece = data.draw(st.binary(max_size=3) | st.sampled_from([b"(", b"[", b"'", b"~", b"True", b"9" * 5, b","]))
        body[at : at + data.draw(st.integers(0, 3))] = piece
    try:
        header = read_npy_header(bytes(body))
    except NpyHeaderError:
        return
    assert isinstance(header, NpyHeader)
    if header.dtype is not None and bytes(body[6:8]) in (b"\1\0", b"\2\0", b"\3\0"):
        numpys = by_numpy(bytes(body))
        assert (header.shape, header.fortran_order, header.dtype, header.offset) == numpys


@settings(max_examples=300, deadline=None)
@given(body=st.binary(max_size=300), version=st.sampled_from([1, 2, 3]))
def test_whatever_follows_the_magic_string_is_answered(body: bytes, version: int) -> None:
    for made in (b"\x93NUMPY" + body, b"\x93NUMPY" + bytes([version, 0]) + body):
        try:
            read_npy_header(made)
        except NpyHeaderError as error:
            assert str(error)  # noqa: PT017 - any message; nothing else may be raised


ENTRIES = "'descr': '<f8', 'fortran_order': False, 'shape': "
HOSTILE = {
    "a chain of operators": "~" * 9000 + "1",
    "a chain of signs": "-" * 9000 + "1",
    "nested parentheses": "(" * 4900 + ")" * 4900,
    "nested lists": "[" * 9000,
    "nested dictionaries": "{1:" * 3000,
    "booleans for lengths": f"{{{ENTRIES}(True, 2), }}",
    "negative lengths": f"{{{ENTRIES}(-3, 2), }}",
    "lengths without end": f"{{{ENTRIES}({'9' * 5000}, 2), }}",
    "nested shape": f"{{{ENTRIES}{'(' * 200}3{',)' * 200}, }}",
    "a number for a shape": f"{{{ENTRIES}(3), }}",
    "a comma for a shape": f"{{{ENTRIES}(,), }}",
    "an open string": "{'descr': '''",
    "a null byte": "{'descr': '<f8\0', 'fortran_order': False, 'shape': (3, 2), }",
    "an unfinished line": "{'descr': '<f8', \\",
    "a type of objects": "{'descr': '|O', 'fortran_order': False, 'shape': (3, 2), }",
    "a type of fields": "{'descr': [('x', '<f8')], 'fortran_order': False, 'shape': (3,), }",
    "a type of arrays": "{'descr': '(1000000000,)f8', 'fortran_order': False, 'shape': (3, 2), }",
    "two shapes": f"{{{ENTRIES}(3, 2), 'shape': (3, 2), }}",
    "no shape": "{'descr': '<f8', 'fortran_order': False, }",
    "another key": f"{{{ENTRIES}(3, 2), 'x': 1, }}",
    "a product": f"{{{ENTRIES}(3*1, 2), }}",
    "an indented line": "    1\n  2",
    "65 dimensions": f"{{{ENTRIES}({'1, ' * 65}), }}",
}


def test_what_numpy_does_not_write_is_refused_and_no_fault(made: Made) -> None:
    for name, text in HOSTILE.items():
        for version in (1, 2, 3):
            body = framed(text, version)
            answer = made.client.post("/v1/back-project", content=body, headers={"content-type": "application/x-npy"})
            assert answer.status_code == 422, (name, version, answer.text)
            assert answer.json()["errors"][0]["field"] == "body"


def test_entries_may_stand_in_any_order_and_without_the_last_comma() -> None:
    body = framed("{'shape': (3, 2), 'fortran_order': False, 'descr': '<f8'}\n", version=2)
    assert read_npy_header(body) == NpyHeader(descr="<f8", fortran_order=False, shape=(3, 2), offset=len(body))


@pytest.mark.parametrize("length", [9_900, 10_001])
def test_a_header_is_read_up_to_its_longest(length: int) -> None:
    text = f"{{{ENTRIES}(3, 2), }}".ljust(length)
    if length > 10_000:
        with pytest.raises(NpyHeaderError, match="too long"):
            read_npy_header(framed(text))
    else:
        assert read_npy_header(framed(text)).shape == (3, 2)
