"""Prints the kernels, with their types, that fits need beyond what `sunarc compile` compiles: a JSON list."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import population as pop

from sunarc.array_types import stacked
from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.answers.direction_table import lookup
from sunarc.calibration.calibrate import calibrate, reproduce_calibration
from sunarc.calibration.changes.step_search import find_pose_steps
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Kind, Sightings
from sunarc.calibration.stated_prior import PriorTolerances, calibrate_with_prior
from sunarc.jit import TolerantCache
from sunarc.offline.compile_kernels import compile_kernels
from sunarc.optics.forward import project

SIZE = (pop.SIZE, pop.SIZE)
CAMERA = pop.random_camera(np.random.default_rng(4))


def day(*, cadence_s: float = 240.0, days: int = 1) -> Sightings:
    """Return sightings of some days, each a pose epoch, every tenth one wrong by some px."""
    times = pop.sun_track(np.arange(float(days)), cadence_s=cadence_s)
    noise = pop.white_noise(np.random.default_rng(5), times.size, 0.03)
    noise[::10] += 5.0
    return replace(pop.sightings(CAMERA, times, noise), epoch=((times - times[0]) // 86_400.0).astype(np.int64))


def with_stars(sun: Sightings, *, wrong_px: float = 0.0) -> Sightings:
    """Return the sightings of the sun and those of a hundred stars of the night after it."""
    directions = hemisphere(100)
    pixels = project(CAMERA, directions) + np.random.default_rng(6).normal(0.0, 0.07 + wrong_px, (len(directions), 2))
    night = Sightings.of(
        unix_s=float(sun.unix_s[-1]) + 30_000.0 + 60.0 * np.arange(len(directions), dtype=np.float64),
        pixels=pixels,
        sigma_px=np.full(len(directions), 0.07),
        directions=directions,
        kind=np.full(len(directions), Kind.STAR),
    )
    return stacked([sun, night])


def fitted(points: Sightings, **given: Any) -> Calibration:  # noqa: ANN401 - whatever `calibrate` takes
    """Return the fit of sightings by the options given."""
    named = {name: given.pop(name) for name in ("start", "circle") if name in given}
    return calibrate(points, site=pop.SGP, image_size=SIZE, options=CalibrationOptions(**given), **named)


def of_a_field() -> Calibration:
    """Return the fit of a record that proves a field of the lens."""
    times = pop.sun_track(np.arange(0.0, 120.0, 10.0), cadence_s=300.0)
    field = pop.smooth_field(np.random.default_rng(7), amplitude_px=1.0, length_px=400.0)
    noise = pop.white_noise(np.random.default_rng(5), times.size, 0.03)
    found = fitted(with_stars(pop.sightings(CAMERA, times, noise, field=field)))
    assert found.camera.displacement is not None
    return found


def answers(found: Calibration) -> None:
    """Look directions and pixels up."""
    ready = lookup(found)
    ready.project(hemisphere(50))
    ready.back_project(project(found.camera, hemisphere(50)))


def work() -> dict[str, Callable[[], object]]:
    """Return fits of all kinds by their names; a robust one of a day is made at once, others start from it."""
    first = fitted(day())
    circle = ImageCircle(x=pop.SIZE / 2.0, y=pop.SIZE / 2.0, radius=pop.SIZE / 2.2)
    return {
        "paper": lambda: fitted(day(), method="paper"),
        "paper, two epochs": lambda: fitted(day(days=2), method="paper"),
        "two epochs": lambda: fitted(day(days=2)),
        "long": lambda: fitted(replace(day(days=4, cadence_s=60.0), epoch=np.zeros(1, dtype=np.int64))),
        "either hand": lambda: fitted(day(), mirrored="auto"),
        "another projection": lambda: fitted(day(), projection="equidistant"),
        "from a start": lambda: fitted(day(), start=first.camera),
        "of an image circle": lambda: fitted(day(), circle=circle),
        "stars": lambda: fitted(with_stars(day())),
        "stars, two epochs": lambda: fitted(with_stars(day(days=2))),
        "stars, paper": lambda: fitted(with_stars(day()), method="paper"),
        "stars that contradict": lambda: fitted(with_stars(day(), wrong_px=20.0)),
        "with a stated camera": lambda: calibrate_with_prior(
            day(cadence_s=1800.0),
            prior=first.camera,
            tolerances=PriorTolerances(lens_px=3.0),
            site=pop.SGP,
            options=CalibrationOptions(),
        ),
        "pose steps": lambda: find_pose_steps(
            day(days=2), site=pop.SGP, image_size=SIZE, options=CalibrationOptions(), lens=first
        ),
        "again": lambda: reproduce_calibration(first, day()),
        "directions": lambda: answers(first),
        "through a field": lambda: answers(of_a_field()),
    }


def main() -> None:
    """Compile ahead, fit, and print what was needed beyond it."""
    needed: list[str] = []
    load = TolerantCache.load_overload

    def noted(self: TolerantCache, sig: object, target_context: object) -> object:
        needed.append(f"{self._py_func.__qualname__} {sig}")
        return load(self, sig, target_context)

    setattr(TolerantCache, "load_overload", noted)  # noqa: B010 - mypy forbids the plain assignment
    compile_kernels()
    ahead = done = len(needed)
    missing = {}
    for name, fit in work().items():
        fit()
        missing[name] = needed[done:]
        done = len(needed)
    print(json.dumps({"ahead": ahead, "missing": missing}))  # noqa: T201


if __name__ == "__main__":
    main()
