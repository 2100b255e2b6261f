"""Answers of the detection on made images, compared with those stored in stored_answers.json.

A place agrees to a fiftieth of its sigma, a number to 0.2 %, a verdict and its codes exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.detection.moon import rendering as moon_rendering
from tests.detection.photo.stack_series import Series, series
from tests.detection.photographs import Photograph, photograph
from tests.detection.rendering import Scene, equisolid_stretch, render
from tests.detection.stars.rendering import FULL_SCALE, GAIN_E, counted, expected, spread_places
from tests.fixtures.stored_answers import require_stored, said

from sunarc.detection.disc.detect import detect_sun
from sunarc.detection.disc.series import combine
from sunarc.detection.exposure_stack import detect_sun_in_stack
from sunarc.detection.moon import MoonExpectation, detect_moon
from sunarc.detection.photo.ordinary_image import Photo, detect_sun_in_photo
from sunarc.detection.photo.urquhart2016 import locate, split_planes
from sunarc.detection.stars.detect import detect_stars
from sunarc.detection.stars.matching import match_stars, share_where_clear
from sunarc.detection.stars.photometry import star_halo
from sunarc.detection.values import Bayer, Detection, Expectation, PredictedStars, Sensor, Stars

FloatArray = NDArray[np.float64]
Answer = Mapping[str, Sequence[object]]

_STORED = Path(__file__).parent / "stored_answers.json"
_RELATIVE, _SIGMAS, _PLACE_PX = 2e-3, 0.02, 1e-3
_STRETCH = equisolid_stretch()


def _detection(found: Detection) -> Answer:
    names = ("sigma_px", "peak_fraction", "background_fraction", "radius_px", "ellipticity", "residual_chi2", "snr")
    answer = said(found.findings)
    numbers: list[object] = [getattr(found, name) for name in (*names, "spread_px")]
    return {
        "codes": [found.verdict, found.method, found.accepted, found.saturated_px, *answer["codes"]],
        "places": [found.x_px, found.y_px],
        "numbers": numbers + answer["numbers"],
    }


def _disc(scene: Scene, cover: FloatArray | None = None, *, predicted: bool = True) -> Detection:
    bayer: Bayer | None = "RGGB" if scene.bayer else None
    sensor = replace(Sensor.from_full_well(full_scale=2**scene.bits - 1, bayer=bayer), black_level=scene.black)
    place = Expectation(x_px=scene.x + 0.7, y_px=scene.y - 0.4, uncertainty_px=1.0, stretch_px_per_rad=_STRETCH)
    image = render(replace(scene, stretch=_STRETCH), np.random.default_rng(11), cover)
    return detect_sun(image, sensor=sensor, expectation=place if predicted else None, exposure_us=20.0)


def _two_discs() -> Detection:
    found = [_disc(Scene(peak=peak, x=x)) for peak, x in ((0.6, 24.2), (0.3, 24.8))]
    return combine(found, shifts=[(0.0, 0.0), (0.6, 0.0)])


def _moon(moon: moon_rendering.Moon) -> Detection:
    sensor = Sensor.from_full_well(full_scale=4095, bayer="GBRG" if moon.bayer else None)
    place = MoonExpectation(
        x_px=moon.x + 0.5,
        y_px=moon.y - 0.3,
        uncertainty_px=1.0,
        edges_px=moon.edges,
        cos_phase=math.cos(math.radians(moon.phase_deg)),
    )
    return detect_moon(moon_rendering.render(moon, seed=4), place, sensor=sensor)


def _photo(scene: Photograph, *, predicted: bool = False) -> Detection:
    x, y = scene.sun_px
    place = Expectation(x_px=x + 1.5, y_px=y - 1.0, uncertainty_px=2.0) if predicted else None
    picture = photograph(scene, np.random.default_rng(5))
    return detect_sun_in_photo(Photo(picture, 255, exposure_us=100.0), expectation=place)


def _stack(what: Series) -> Detection:
    return detect_sun_in_stack([Photo(image, 255, float(us)) for us, image in series(what, 3).items()])


def _five_estimators() -> Answer:
    picture = photograph(Photograph(size=480, smear=0.3), np.random.default_rng(6))
    found = locate(split_planes(picture, full_scale=255), apparent_zenith=math.radians(40.0))
    assert found is not None
    return {
        "places": [*found.position, *found.columns, *found.rows],
        "numbers": [found.diameter, found.sigma, found.spread_px],
    }


def _starry(seed: int = 7) -> tuple[NDArray[np.uint16], FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    places = spread_places(rng, 256)
    light = np.geomspace(1.5e3, 6e5, len(places))
    return counted(rng, expected(places, light, size=256, width=1.2)), places, light


def _stars(*, bayer: Bayer | None = None, gain_e: float | None = GAIN_E) -> Answer:
    image, _, _ = _starry()
    found = detect_stars(image, full_scale=FULL_SCALE, gain_e_per_count=gain_e, bayer=bayer)
    numbers = ("sigma_px", "flux", "snr", "peak_fraction", "width_px", "ellipticity")
    values = [np.asarray(getattr(found, name)) for name in numbers]
    columns = [x for each in values for x in np.quantile(each[np.isfinite(each)], [0.1, 0.5, 0.9]).tolist()]
    halo = star_halo(image, found, full_scale=FULL_SCALE, bayer=bayer)
    return {
        "codes": [len(found), int(np.sum(found.saturated))],
        "places": np.quantile(found.pixels, [0.1, 0.3, 0.5, 0.7, 0.9], axis=0).ravel().tolist(),
        "numbers": [*columns, halo],
    }


def _matched() -> Answer:
    rng = np.random.default_rng(8)
    places = rng.uniform(30.0, 970.0, (400, 2))
    magnitude = np.sort(5.5 + np.log(rng.uniform(size=400)) / math.log(3.0))
    predicted = PredictedStars(
        names=np.array([f"star:HIP{k}" for k in range(400)]),
        pixels=places + 1e-6 * (places - 500.0) ** 2,
        sigma_px=np.full(400, 1.5),
        magnitude=magnitude,
        azimuth_deg=np.degrees(np.arctan2(*(places - 500.0).T)),
    )
    clear = (places[:, 0] > 300.0) & (rng.random(400) < 0.9)
    flux = 10.0 ** (-0.4 * (magnitude + rng.normal(0.0, 0.2, 400)))
    one = np.ones(400)
    stars = Stars(
        pixels=places + rng.normal(0.0, 0.2, places.shape), sigma_px=0.2 * one, flux=flux, snr=30.0 * one,
        peak_fraction=0.3 * one, width_px=1.2 * one, ellipticity=0.1 * one, saturated=one < 0.0,
    ).select(clear)  # fmt: skip
    matched = match_stars(stars.select(np.argsort(-stars.flux)), predicted)
    answer = said(matched.findings)
    return {
        "codes": [matched.accepted, matched.star.size, *answer["codes"]],
        "numbers": [matched.explained, matched.found, matched.scatter_px, share_where_clear(places, clear)]
        + answer["numbers"],
    }


def _every(found: Sequence[Detection]) -> Answer:
    """Return the verdicts of many, and the numbers of those that are accepted."""
    answers = [_detection(one) for one in found]
    return {
        "codes": [code for one in answers for code in one["codes"]],
        "numbers": [
            x
            for one, each in zip(found, answers, strict=True)
            if one.accepted
            for x in (*each["places"], *each["numbers"])
            if x is not None
        ],
    }


def _discs_in_a_sweep() -> Answer:
    """Return discs ever brighter, more covered, in a brighter sky, further off, more blurred, larger and longer."""
    sweep: list[tuple[dict[str, float], FloatArray | None, dict[str, float]]] = []
    sweep += [({"peak": peak}, None, {}) for peak in np.geomspace(0.008, 1.6, 15).tolist()]
    sweep += [({"peak": peak}, None, {"alone": 1.0}) for peak in np.geomspace(0.02, 1.2, 12).tolist()]
    sweep += [({"peak": 0.3, "background": sky}, None, {}) for sky in np.geomspace(0.02, 0.6, 7).tolist()]
    sweep += [({}, np.array([0.6, 0.8, to, 0.15, 0.1]), {}) for to in np.linspace(-1.1, 1.4, 8).tolist()]
    sweep += [({}, np.array([0.0, 1.0, 0.0, 4.0, least]), {}) for least in np.linspace(0.1, 0.9, 5).tolist()]
    sweep += [({}, None, {"off": off}) for off in np.linspace(0.0, 9.0, 7).tolist()]
    sweep += [({"psf_px": psf}, None, {"alone": alone}) for psf in (0.3, 0.5, 1.1, 1.6, 2.6) for alone in (0.0, 1.0)]
    sweep += [({"size": size}, None, {"alone": 1.0}) for size in (0.3, 0.45, 0.7, 1.5, 2.3, 3.4, 4.5)]
    sweep += [({"long": long}, None, {"alone": 1.0}) for long in (1.3, 1.8, 2.4, 2.8)]
    sweep += [({}, None, {"clear": clear}) for clear in (0.8, 1.3, 1.5, 6e3, 8e3)]
    found = []
    for number, (of_scene, cover, of_prediction) in enumerate(sweep):
        size, long = of_scene.pop("size", 1.0), of_scene.pop("long", 1.0)
        stretch = np.array(_STRETCH) * size @ np.diag([long, 1.0])
        scene = Scene(**{"peak": 0.6, **of_scene}, stretch=tuple(map(tuple, stretch.tolist())))  # type: ignore[arg-type]
        image = render(scene, np.random.default_rng(number), cover)
        place = Expectation(
            x_px=scene.x + 0.7 + of_prediction.get("off", 0.0), y_px=scene.y - 0.4, uncertainty_px=0.5,
            stretch_px_per_rad=scene.stretch, clear_peak_fraction=of_prediction.get("clear"),
        )  # fmt: skip
        alone = of_prediction.get("alone", 0.0) > 0.0
        sensor = Sensor.from_full_well(full_scale=4095)
        found.append(detect_sun(image, sensor=sensor, expectation=None if alone else place, exposure_us=20.0))
    return _every(found)


def _moons_in_a_sweep() -> Answer:
    """Return moons of all phases, in ever more haze and cloud, fainter, larger and further off."""
    sweep: list[dict[str, float]] = [{"phase_deg": phase} for phase in (120.0, 157.0, 163.0)]
    sweep += [{"halo": halo} for halo in (0.05, 0.3)] + [{"cloud": 0.8}]
    sweep += [{"peak": peak} for peak in (0.006, 0.03, 1.2)]
    sweep += [{"radius_px": 1.6}] + [{"off": off} for off in (3.5, 6.0)]
    found = []
    for number, given in enumerate(sweep):
        off = given.pop("off", 0.5)
        moon = moon_rendering.Moon(**{"phase_deg": 80.0, **given})  # type: ignore[arg-type]
        place = MoonExpectation(
            x_px=moon.x + off, y_px=moon.y - 0.3, uncertainty_px=1.0, edges_px=moon.edges,
            cos_phase=math.cos(math.radians(moon.phase_deg)),
        )  # fmt: skip
        image = moon_rendering.render(moon, seed=number)
        found.append(detect_moon(image, place, sensor=Sensor.from_full_well(full_scale=4095)))
    return _every(found)


_EDGE = np.array([0.6, 0.8, 0.1, 0.3, 0.2])
_ANSWERS: dict[str, Callable[[], Detection | Answer]] = {
    "disc": lambda: _disc(Scene(peak=0.6), predicted=False),
    "disc_of_a_mosaic": lambda: _disc(Scene(peak=0.7, bayer="RGGB", background=0.02, slope_per_px=(3e-4, -2e-4))),
    "disc_behind_an_edge": lambda: _disc(Scene(peak=0.6), _EDGE),
    "disc_saturated": lambda: _disc(Scene(peak=1.4, black=200.0)),
    "disc_of_8_bits": lambda: _disc(Scene(peak=0.4, bits=8)),
    "discs": _two_discs,
    "moon": lambda: _moon(moon_rendering.Moon(phase_deg=40.0, halo=0.1)),
    "moon_of_a_mosaic": lambda: _moon(moon_rendering.Moon(phase_deg=100.0, bayer="GBRG")),
    "moon_behind_cloud": lambda: _moon(moon_rendering.Moon(phase_deg=70.0, cloud=0.6)),
    "photo": lambda: _photo(Photograph(size=480)),
    "photo_predicted": lambda: _photo(Photograph(size=480, streaks=4, smear=0.2), predicted=True),
    "photo_cloudy": lambda: _photo(Photograph(size=480, bright_cloud=True, thin_cloud=1.0), predicted=True),
    "stack": lambda: _stack(Series(sun=(190.3, 140.6), size=(320, 240))),
    "stack_behind_cloud": lambda: _stack(Series(sun=(190.3, 140.6), size=(320, 240), dimmed=0.3, glint=(90.0, 180.0))),
    "five_estimators": _five_estimators,
    "discs_in_a_sweep": _discs_in_a_sweep,
    "moons_in_a_sweep": _moons_in_a_sweep,
    "stars": _stars,
    "stars_of_a_mosaic": lambda: _stars(bayer="RGGB", gain_e=None),
    "stars_matched": _matched,
}


@pytest.mark.parametrize("name", _ANSWERS)
def test_an_answer_is_the_stored_one(name: str) -> None:
    found = _ANSWERS[name]()
    if not isinstance(found, Detection):
        require_stored(_STORED, name, found, relative=_RELATIVE, apart_px=_PLACE_PX)
    else:
        apart_px = _SIGMAS * (found.sigma_px or math.inf)
        require_stored(_STORED, name, _detection(found), relative=_RELATIVE, apart_px=apart_px)
