"""The kernels of the first sighting are compiled for the frames that cameras give."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from sunarc.offline.compile_kernels import _CENTRE_PX, _drawn_sun, compile_kernels

MODULE = sys.modules[compile_kernels.__module__]  # the room's name of it is the function


def test_the_drawn_sun_has_the_area_of_its_disc() -> None:
    drawn = _drawn_sun(255) / 255.0
    area = float(np.sum(drawn - 0.01)) / 0.6
    assert area == pytest.approx(np.pi * 9.0**2, rel=0.02)


def test_the_drawn_sun_is_centred() -> None:
    drawn = _drawn_sun(4095)
    y, x = np.mgrid[: drawn.shape[0], : drawn.shape[1]]
    weight = drawn - drawn.min()
    centre = [float(np.sum(axis * weight) / np.sum(weight)) for axis in (x, y)]
    assert centre == pytest.approx([_CENTRE_PX] * 2, abs=0.01)


def test_read_only_frames_of_8_and_16_bit_are_detected_with_and_without_expectation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[tuple[type, bool, bool]] = []
    merged: list[type] = []

    def detect(image: np.ndarray, *, expectation: object, **_: object) -> None:
        calls.append((image.dtype.type, image.flags.writeable, expectation is not None))

    def merge(frames: list[np.ndarray], *_: object, **__: object) -> None:
        merged.extend(frame.dtype.type for frame in frames)

    monkeypatch.setattr(MODULE, "detect_sun", detect)
    monkeypatch.setattr(MODULE, "merge_hdr", merge)
    compile_kernels()
    assert set(calls) == {(kind, False, known) for kind in (np.uint8, np.uint16) for known in (False, True)}
    assert set(merged) == {np.uint8, np.uint16}
