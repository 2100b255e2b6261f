"""Every reader of files bears some damaged ones; `tests/release/run fuzz` draws a million."""

from __future__ import annotations

import mmap
import os
import re
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.sources import fuzz
from tests.sources.fuzz import Reader, ask, edited, fuzzed, fuzzed_apart, readers, with_right_sums

from sunarc.common.errors import InputError, OutsideError
from sunarc.formats.formats import FORMATS

CASES = 25
NAMES = (
    *("sightings", "pairs", "settings", "hub", "npy", "document", "feed", "entry", "case", "joint", "lens"),
    *("image.png", "image.jpg", "image.tiff", "image.bmp", "archive.png", "archive.jpg", "archive.tiff"),
    *("archive.bmp", "archive.webp", "fits.gz", "netpbm", "netpbm.gz", "bmp.gz", "trex"),
    *("document-in-image", "exif", "sidecar", "cameras", "fits", "netcdf", "video"),
    *("leaf-rows", "ledger", "warm-pixels"),
    *(f"view-{form.name}" for form in FORMATS.values() if form.read is not None),
)


@pytest.fixture(scope="module")
def made() -> dict[str, Reader]:
    """Return the readers by their names; their files take seconds to make."""
    return {one.name: one for one in readers()}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", NAMES)
def test_a_reader_answers_or_refuses_whatever_it_is_given(name: str, made: dict[str, Reader]) -> None:
    if name not in made:
        pytest.skip(f"{name} writes no file of such a lens, or its extra is missing")
    tally = fuzzed(made[name], count=CASES, number=1)
    assert tally.failures == {}
    assert tally.answered + tally.refused == CASES


def first_found(made: dict[str, Reader]) -> Iterator[tuple[str, bytes]]:
    """Yield files that readers did not bear when a million was asked first."""
    for name in ("image.png", "archive.png"):
        png = made[name].sound[0]
        at = png.index(b"IDAT") - 4
        yield name, png[:at] + b"\x7f\xff\xff\xff" + png[at + 4 :]  # the decoder took 2 GB
    bmp = made["image.bmp"].sound[0]
    yield "image.bmp", bmp[:22] + b"\xff\xff\xff\x7f" + bmp[26:]
    mp4 = made["video"].sound[1]
    at = mp4.index(b"stts") + 12
    yield "video", mp4[:at] + b"\x5b" * 4 + mp4[at + 4 :]  # 1.5 billion frames, each with its time
    opencv = made["view-opencv"].sound[0]
    yield "view-opencv", opencv.replace(b"   cols: 1", b"   ccccols: 1")  # OpenCV's own reader ended the process
    nested = b'{"a":' * 3000
    yield from ((name, nested) for name in ("view-json", "view-ros", "sidecar") if name in made)
    yield from ((name, b"port = " + b"1" * 5000) for name in ("settings", "hub", "cameras", "joint"))
    yield from ((name, b"port = " + b"[" * 3000) for name in ("settings", "hub", "cameras", "joint"))
    yield "exif", b"\xff\xd8\xff\xc0\x00\x0b\x08null\x01\x00\x00\x00"  # 785 million pixels
    yield "sidecar", b'{"exposure_us": ' + b"9" * 400 + b"}"
    yield "cameras", b"[cameras.a]\nlatitude = 1\nlongitude = 2\naltitude = " + b"1" * 400
    for name in ("document", "lens"):  # a whole number that no double holds, in every place
        sound = made[name].sound[0]
        places = list(re.finditer(rb"(?<=[ \[])-?\d[\d.e+-]*(?=[,\]}])", sound))
        yield from ((name, sound[: one.start()] + b"9" * 400 + sound[one.end() :]) for one in places)
    database = made["leaf-rows"].sound[0]
    yield "leaf-rows", database[:16] + b"\0\0" + database[18:]
    for name in ("ledger", "fits", "netcdf"):
        sound = made[name].sound[0]
        yield from ((name, sound[:at] + b"\xff" * 8 + sound[at + 8 :]) for at in range(100, len(sound), 997))


@pytest.mark.filterwarnings("ignore")
def test_what_was_found_once_is_borne(made: dict[str, Reader], tmp_path: Path) -> None:
    asked = [(name, ask(made[name], content, tmp_path).why) for name, content in first_found(made)]
    assert [one for one in asked if one[1] is not None] == []


def test_a_salvage_reads_rows_behind_a_damaged_page_size(made: dict[str, Reader], tmp_path: Path) -> None:
    reader = made["leaf-rows"]
    sound = reader.read(reader.sound[0], tmp_path)
    assert sound
    assert reader.read(reader.sound[0][:16] + b"\0\0" + reader.sound[0][18:], tmp_path) == sound


def test_a_damaged_answer_of_a_ledger_is_made_again_and_a_damaged_ledger_named(tmp_path: Path) -> None:
    path = tmp_path / "a.sqlite"
    path.write_bytes(fuzz.ledger_file().replace(b'{"refused"', b'{"refusex"'))
    answers, _ = fuzz.ledger_of(path)
    assert answers == []
    path.write_bytes(fuzz.ledger_file()[:5000])
    with pytest.raises(OutsideError):
        fuzz.ledger_of(path)


def test_every_reader_is_asked(made: dict[str, Reader]) -> None:
    assert set(made) <= set(NAMES)


def test_what_a_reader_must_not_do_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz, "SLOWEST_S", 0.05)

    def slow(content: bytes, _: Path) -> object:
        return sum(range(10**7)) if content else None

    def broken(content: bytes, _: Path) -> object:
        return content[100]

    def refusing(content: bytes, _: Path) -> object:
        raise InputError(field="a", problem=str(len(content)), remedy="b")

    found = [ask(Reader("one", (b"a",), read), b"a", tmp_path) for read in (slow, broken, refusing)]
    assert [one.why is None for one in found] == [False, False, True]
    assert [one.refused for one in found] == [False, False, True]


def test_a_reader_that_ends_its_process_or_hangs_is_found_and_the_others_go_on() -> None:
    def dies(content: bytes, _: Path) -> object:
        if content.startswith(b"b"):
            os.kill(os.getpid(), signal.SIGTERM)
        return None

    def hangs(content: bytes, _: Path) -> object:
        return threading.Event().wait() if content.startswith(b"b") else None

    sound = (b"a" * 50, b"b" * 50)
    died = fuzzed_apart(Reader("dies", sound, dies), count=8, number=1)
    assert {one.why for one in died.failures.values()} == {"ended by signal 15"}
    assert died.n_failed == len(died.failures)
    assert died.answered + died.n_failed == 8
    hung = fuzzed_apart(Reader("hangs", sound, hangs), count=3, number=1, longest_s=0.2)
    assert {one.why for one in hung.failures.values()} == {"hangs"}


def test_a_reader_that_keeps_what_it_reads_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz, "MOST_MB", 20.0)
    monkeypatch.setattr(fuzz, "_SETTLED", 10)
    monkeypatch.setattr(fuzz, "_LOOKED_EVERY", 10)
    kept: list[mmap.mmap] = []  # pages of their own: this process's heap may have room for all

    def read(_content: bytes, _path: Path) -> None:
        kept.append(mmap.mmap(-1, 10**6))
        kept[-1].write(b"x" * 10**6)

    tally = fuzzed(Reader("grows", (b"a",), read), count=60, number=1)
    assert list(tally.failures) == ["grows"]


def test_a_file_that_fails_is_shortened(tmp_path: Path) -> None:
    def read(content: bytes, _: Path) -> object:
        return 1 // (b"X" not in content)

    reader = Reader("one", (b"a",), read)
    kind = fuzz.kind_of_failure(ask(reader, b"X", tmp_path).why or "")
    assert fuzz.shortened(reader, b"abcXdefX" * 9, kind, tmp_path) == b"X"


def test_an_edit_changes_a_file_where_it_says() -> None:
    assert edited(b"abcdef", [("set", 1, 2, b"X")]) == b"aXdef"
    assert edited(b"abcdef", [("cut", 1, 2, b"")]) == b"adef"
    assert edited(b"abcdef", [("end", 2, 0, b"")]) == b"ab"
    assert edited(b"ab", [("double", 0, 1, b"")]) == b"aaaab"
    assert edited(b"a", [("flip", 0, 1, b"")]) == b"c"


def test_a_png_gets_the_sums_of_its_chunks_again() -> None:
    sound = cv2.imencode(".png", np.zeros((4, 4), np.uint8))[1].tobytes()
    assert with_right_sums(sound[:40] + b"Z" + sound[41:]) != sound
    assert with_right_sums(sound[:-2] + b"ZZ") == sound
