"""A camera that answers a packet resend with another packet: whole frames, and rows of another one in them.

The frames are rendered by a renderer of their own; a packet is a run of consecutive bytes of a frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.detection.rendering import FULL_WELL_E, READ_NOISE_E, Scene, disc_image, equisolid_stretch, mosaic_gains
from tests.detection.rendering import read_out as noisy
from tests.fixtures.archive import new_archive
from tests.fixtures.calibrations import SITE

from sunarc.detection.values import DiscOptions, Expectation
from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.archive.values import SunPoint
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.detect import DetectWorker, FrozenFrames, SightingWriteBuffer
from sunarc.imager.workers.options import SensorOptions

from .conftest import NOON

ROWS, SIDE = 45, 45
CASES = 320
EXPOSURES = {"darker": 0.25, "brighter": 4.0, "dark": 0.02, "normal": 60.0, "earlier": 1.0, "itself": 1.0}


@dataclass(kw_only=True)
class Pair:
    """A frame with noise, and the same without any."""

    counts: np.ndarray[Any, Any]
    quiet: np.ndarray[Any, Any]


def taken(scene: Scene, width: int, left: int, rng: np.random.Generator) -> Pair:
    """Return a frame as wide as the sensor, its sun in the columns after `left`."""
    light = np.full((ROWS, width), scene.background)
    light[:, left : left + SIDE] += scene.peak * disc_image(replace(scene, shape=(ROWS, SIDE)))
    wide = replace(scene, shape=light.shape)
    full = 2**scene.bits - 1
    exact = light * mosaic_gains(wide) if scene.bayer else light
    quiet = np.clip(np.rint(exact * full), 0, full).astype(np.uint8 if scene.bits == 8 else np.uint16)
    return Pair(counts=noisy(light, wide, rng), quiet=quiet)


@dataclass(kw_only=True)
class Case:
    """A frame, another one, and the frame with packets of the other; the truth, and what is predicted."""

    scene: Scene
    whole: Pair
    other: Pair
    mixed: Pair
    expectation: Expectation | None
    sun: tuple[float, float] = field(default=(0.0, 0.0))


def case_of(number: int) -> Case:
    rng = np.random.default_rng([33, 11, number])
    width = int(rng.choice([420, 640, 1024]))
    left = int(rng.integers(0, (width - SIDE) // 2)) * 2
    stretch = equisolid_stretch(
        zenith_deg=rng.uniform(5, 80), azimuth_deg=rng.uniform(0, 360), alpha_px=float(rng.choice([300.0, 601.32]))
    )
    peak = float(rng.uniform(0.1, 0.9) if rng.random() < 0.7 else rng.uniform(0.9, 4.0))
    scene = Scene(
        x=SIDE // 2 + rng.uniform(-0.5, 0.5), y=ROWS // 2 + rng.uniform(-0.5, 0.5), stretch=stretch, peak=peak, over=5,
        psf_px=rng.uniform(0.55, 0.9), background=peak * rng.uniform(0.001, 0.02), bits=int(rng.choice([8, 12, 12])),
        bayer="RGGB" if rng.random() < 0.15 else None,
    )  # fmt: skip
    whole = taken(scene, width, left, rng)
    kind = list(EXPOSURES)[number % len(EXPOSURES)]
    moved_px = rng.uniform(-4.0, 4.0, 2) if kind == "earlier" else rng.uniform(-0.05, 0.05, 2)
    factor = EXPOSURES[kind]
    before = replace(
        scene,
        peak=peak * factor,
        background=scene.background * factor,
        x=scene.x + moved_px[0],
        y=scene.y + moved_px[1],
    )
    other = whole if kind == "itself" else taken(before, width, left, rng)
    mixed = with_packets(whole, other, kind, left + SIDE // 2, rng)
    sun = (scene.x + left, scene.y)
    near = rng.normal(sun, 0.3)
    told = Expectation(x_px=near[0], y_px=near[1], uncertainty_px=2.0, stretch_px_per_rad=stretch)
    return Case(
        scene=scene, whole=whole, other=other, mixed=mixed, sun=sun, expectation=told if rng.random() < 0.7 else None
    )


def with_packets(whole: Pair, other: Pair, kind: str, column: int, rng: np.random.Generator) -> Pair:
    """Return a frame with one or two packets near the sun that are of another frame, or of another place."""
    width = whole.counts.shape[1]
    length = min(int(rng.integers(540, 8964)) // whole.counts.itemsize, 8 * width)
    mixed = Pair(counts=whole.counts.copy(), quiet=whole.quiet.copy())
    for _ in range(1 + (rng.random() < 0.2)):
        sun = (ROWS // 2 + int(rng.integers(-6, 7))) * width + column + int(rng.integers(-8, 9))
        first = max(sun - int(rng.integers(0, length)), 0)
        last = min(first + length, whole.counts.size)
        from_first = first
        if kind == "itself":
            from_first += length * int(rng.choice([-2, -1, 1, 2]))
            from_first = min(max(from_first, 0), whole.counts.size - (last - first))
        for target, source in ((mixed.counts, other.counts), (mixed.quiet, other.quiet)):
            target.ravel()[first:last] = source.ravel()[from_first : from_first + last - first]
    return mixed


class Bench:
    """A detection worker that stores what it finds in an archive."""

    def __init__(self, archive: Archive, board: StatusRegistry, sensor: SensorOptions) -> None:
        self._archive = archive
        self._told: Expectation | None = None
        predictor = SimpleNamespace(expectation=lambda _: self._told, clear_level_per_us=lambda _: 0.0)
        self._worker = DetectWorker(
            DropOldestQueue(capacity=4),
            keeper=SightingWriteBuffer(archive, board=board),
            camera="roof",
            predictor=predictor,  # type: ignore[arg-type]
            options=sensor,
            disc=DiscOptions(),
            clock_error_s=lambda _: 0.01,
            report=lambda *_: None,
            board=board,
            frozen=FrozenFrames(CameraArchive(archive, name="roof", site=SITE), board=board),
            cadence_s=30.0,
        )
        self._at = NOON

    def stored(self, image: np.ndarray[Any, Any], case: Case) -> SunPoint:
        """Return the sighting that is stored of an image."""
        self._at += timedelta(seconds=30)
        self._told = case.expectation
        colours = f"Bayer{case.scene.bayer[:2]}" if case.scene.bayer else "Mono"
        self._worker.process(
            Frame(
                image=image,
                time=self._at,
                exposure_us=20.0,
                gain_db=0.0,
                pixel_format=f"{colours}{case.scene.bits}",
                full_scale=2**case.scene.bits - 1,
                frame_id=1,
            )
        )
        return point_at(self._archive, self._at)


def point_at(archive: Archive, time: datetime) -> SunPoint:
    (point,) = archive.sightings.find("roof", since=time, until=time + timedelta(seconds=1))
    return point


def off_px(point: SunPoint, at: tuple[float, float]) -> float:
    return math.inf if point.x_px is None or point.y_px is None else math.hypot(point.x_px - at[0], point.y_px - at[1])


@pytest.mark.slow
def test_rows_of_another_frame_bias_no_accepted_sighting_and_whole_frames_are_accepted_as_before(
    tmp_path: Path, board: StatusRegistry
) -> None:
    options = SensorOptions(full_well_e=FULL_WELL_E, read_noise_e=READ_NOISE_E)
    camera, sound = (Bench(new_archive(tmp_path / name), board, options) for name in ("camera", "sound"))
    compared, accused, biased, beyond = 0, 0, list[int](), list[int]()
    for number in range(CASES):
        case = case_of(number)
        whole = sound.stored(case.whole.counts, case)
        accused += any(one.code == "disc_foreign_rows" for one in whole.findings) or whole.verdict == "frozen"
        if not whole.accepted:
            continue
        compared += 1
        if case.other is not case.whole:
            camera.stored(case.other.counts, case)  # the camera's own memory holds what it had sent
        mixed = camera.stored(case.mixed.counts, case)
        if not mixed.accepted or not mixed.sigma_px:
            continue
        clean, foreign = (sound.stored(image, case) for image in (case.whole.quiet, case.mixed.quiet))
        if clean.x_px is None or clean.y_px is None or off_px(foreign, (clean.x_px, clean.y_px)) > mixed.sigma_px:
            biased.append(number)
        if off_px(mixed, case.sun) > 5.0 * mixed.sigma_px:
            beyond.append(number)
    assert compared >= 300
    assert len(biased) <= 0.01 * compared
    assert beyond == []
    assert accused <= 0.005 * CASES
