"""The kernels of the first sighting are compiled for the frames that cameras give."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sunarc.offline.compile_kernels import CENTRE_PX, compile_kernels, drawn_sun

ROOT = Path(__file__).parents[2]
MODULE = sys.modules[compile_kernels.__module__]  # the room's name of it is the function


def test_the_drawn_sun_has_the_area_of_its_disc() -> None:
    drawn = drawn_sun(255) / 255.0
    area = float(np.sum(drawn - 0.01)) / 0.6
    assert area == pytest.approx(np.pi * 9.0**2, rel=0.02)


def test_the_drawn_sun_is_centred() -> None:
    drawn = drawn_sun(4095)
    y, x = np.mgrid[: drawn.shape[0], : drawn.shape[1]]
    weight = drawn - drawn.min()
    centre = [float(np.sum(axis * weight) / np.sum(weight)) for axis in (x, y)]
    assert centre == pytest.approx([CENTRE_PX] * 2, abs=0.01)


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
    compile_kernels(first_sighting_alone=True)
    assert set(calls) == {(kind, False, known) for kind in (np.uint8, np.uint16) for known in (False, True)}
    assert set(merged) == {np.uint8, np.uint16}


@pytest.mark.timeout(900)
def test_a_fit_needs_no_kernel_that_was_not_compiled_ahead() -> None:
    """In a process of its own, which has no kernel in memory: each that is looked for in the cache counts."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "docs" / "studies")}
    command = [sys.executable, str(Path(__file__).with_name("fits_after_compiling.py"))]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["ahead"] > 25
    assert {name: new for name, new in found["missing"].items() if new} == {}
