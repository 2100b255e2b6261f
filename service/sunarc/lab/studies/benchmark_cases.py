"""The cases of the benchmark: lenses, suns and errors drawn from a seed, with the truth of each.

The lens is this package's camera with a radial residual that its polynomial does not hold. A second generator, which
shares no code with this one, is `docs/studies/benchmark_second.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.array_types import BoolArray, FloatArray, NameArray
from sunarc.common.utc import DAY_S
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project, tangent_basis
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles, rotation_matrix, rotation_vector
from sunarc.optics.projections import PROJECTIONS, Projection, ideal_radius
from sunarc.sky.directions import angles_from_direction, direction_from_angles
from sunarc.sky.night import SUN, night_sky
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

FAR_DEG = 40.0
"""Directions further than this from every sighting are far from the track."""
_CADENCE_S = 120.0
_LOWEST_SUN_DEG = 2.0
_QUERIES = 300
_STEP = 1e-4
"""Of the derivatives, radians."""
_SIGMA_PX = 0.3
"""Of a sighting per axis, in an image of `_USUAL_PX`."""
_USUAL_PX = 1748
_COMPASS_DEG = 5.0
"""How well a mount is known without a calibration."""
_STAR_V, _STAR_SIGMA_PX, _DARK_DEG = 3.5, 0.15, 105.0
_STAR_ZENITH_DEG = 82.0

LENSES = (
    "paper", "equidistant", "equisolid", "stereographic", "orthographic", "perspective", "phone", "wide", "decentred",
    "nonsquare", "unknown",
)  # fmt: skip
CONDITIONS = (
    "clear", "correlated", "cloud", "haze", "half_day", "drifting_clock", "moved_mount", "twenty_minutes",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BenchmarkCase:
    """Input of an entrant.

    Attributes
    ----------
    name : of the case.
    site : where the camera stands.
    image_size : width and height, px.
    projection : as the lens's data sheet has it; None: not known.
    sightings : times as recorded, pixels, bodies; the stars' 1-sigma is stated, and so are their directions.
    apparent : (n, 3) where the bodies were at the recorded times.
    queries : (m, 2) pixels whose directions are asked for.
    """

    name: str
    site: Site
    image_size: tuple[int, int]
    projection: Projection | None
    sightings: Sightings
    apparent: FloatArray
    queries: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BenchmarkTruth:
    """Truth that is withheld from an entrant.

    Attributes
    ----------
    lens, condition : which of `LENSES` and `CONDITIONS`, or names of another generator's.
    answerable : whether the sightings determine the camera; an honest entrant refuses where they do not.
    pixels : (m, 2) as asked.
    directions : (m, 3) where they look.
    track_deg : (m,) degrees from there to the nearest sighting.
    px_per_deg : (m, 2, 2) derivatives of x and y by a change to larger zenith angles, and to larger azimuths.
    fallback_deg : (m,) error of who has no calibration: the data sheet, and the mount to 5 degrees.
    """

    lens: str
    condition: str
    answerable: bool
    pixels: FloatArray
    directions: FloatArray
    track_deg: FloatArray
    px_per_deg: FloatArray
    fallback_deg: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Instrument:
    """A camera, and the outward displacement of its pixels, px, by the angle off the axis and the one about it."""

    camera: Camera
    nominal: Camera
    known: bool
    outwards_px: Callable[[FloatArray, FloatArray], FloatArray]

    def sees(self, directions: FloatArray) -> FloatArray:
        """Return pixels (n, 2) of directions (n, 3); NaN beyond the lens's field."""
        x, y, z = rotation_matrix(self.camera.rotation_cam_enu) @ directions.T
        azimuth = np.arctan2(y, x)
        shift = self.outwards_px(np.arctan2(np.hypot(x, y), z), azimuth)
        outwards = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
        return np.asarray(project(self.camera, directions) + shift[:, None] * outwards)

    def turned(self, rng: np.random.Generator, degrees: float) -> _Instrument:
        """Return the instrument rotated by an angle about a random axis."""
        return replace(self, camera=_turn_camera(self.camera, rng, degrees))


def benchmark_case(number: int, *, seed: int, night: bool) -> tuple[BenchmarkCase, BenchmarkTruth]:
    """Draw a case: its lens and its condition go by its number, all else by the seed.

    Parameters
    ----------
    number : from 0; 88 numbers have all lenses in all conditions.
    seed : of everything that is drawn.
    night : whether three images of stars of the night after the last day are among the sightings.
    """
    rng = np.random.default_rng((seed, number))
    kind, condition = LENSES[number % len(LENSES)], CONDITIONS[number % len(CONDITIONS)]
    site = _draw_site(rng)
    instrument = _draw_instrument(kind, rng, site)
    times = _draw_times(rng, site, condition)
    times = times[_is_in_image(instrument.camera, instrument.sees(sun_directions(times, site)))]
    before = instrument
    if condition == "moved_mount":
        instrument = instrument.turned(rng, float(rng.uniform(0.5, 3.0)))
    sightings = _draw_sun_sightings(rng, times, site, (before, instrument), condition)
    if night:
        sightings = _add_night_stars(rng, sightings, site, instrument)
    apparent = np.where((sightings.body == SUN)[:, None], sun_directions(sightings.unix_s, site), sightings.directions)
    truth = _draw_truth(rng, instrument, apparent, kind=kind, condition=condition, answerable=night or times.size > 60)
    case = BenchmarkCase(
        name=f"{'n' if night else 's'}{number:03d}",
        site=site,
        image_size=(instrument.camera.width, instrument.camera.height),
        projection=instrument.camera.projection if instrument.known else None,
        sightings=sightings,
        apparent=apparent,
        queries=truth.pixels,
    )
    return case, truth


def benchmark_cases(
    count: int, *, seed: int, night: bool, first: int = 0
) -> Iterator[tuple[BenchmarkCase, BenchmarkTruth]]:
    """Yield so many cases, from a number on."""
    return (benchmark_case(number, seed=seed, night=night) for number in range(first, first + count))


def _draw_site(rng: np.random.Generator) -> Site:
    side = 1.0 if rng.random() < 0.7 else -1.0
    return Site(
        latitude=side * rng.uniform(15.0, 58.0), longitude=rng.uniform(-150.0, 150.0), altitude=rng.uniform(0.0, 1500.0)
    )


def _draw_instrument(kind: str, rng: np.random.Generator, site: Site) -> _Instrument:
    """Draw a lens of a kind on its mount."""
    size, edge, wave_px, tilt = (_USUAL_PX, _USUAL_PX), 90.0, 1.0, abs(float(rng.normal(0.0, 2.5)))
    projection: Projection = "equisolid"
    if kind in PROJECTIONS:
        projection = kind  # type: ignore[assignment] # it is one of them
    if kind in {"wide", "unknown"}:
        projection, edge = "equidistant", 110.0 if kind == "wide" else 90.0
    if kind in {"perspective", "phone"}:
        size, edge = ((1920, 1440), 60.0) if kind == "perspective" else ((4032, 3024), 36.0)
        projection, tilt = "perspective", tilt if kind == "perspective" else float(rng.uniform(25.0, 40.0))
    focal = 0.486 * min(size) / float(ideal_radius(projection, math.radians(edge)))
    offset = rng.normal(0.0, 0.003 if kind != "decentred" else 0.04, 2) * min(size)
    stretch = 1.0 + (float(rng.choice([-1.0, 1.0]) * rng.uniform(0.003, 0.06)) if kind == "nonsquare" else 0.0)
    bent = rng.normal(0.0, 4.0 if kind == "decentred" else 0.4, 2)
    # towards the sun's path at noon where it is tilted on purpose
    south = 180.0 if site.latitude > 0.0 else 0.0
    lean = south + float(rng.normal(0.0, 20.0)) if kind == "phone" else float(rng.uniform(0.0, 360.0))
    reach = float(ideal_radius(projection, math.radians(min(edge, 80.0))))
    nominal = Camera(
        width=size[0],
        height=size[1],
        projection=projection,
        focal_length_px=(focal, focal),
        principal_point_px=((size[0] - 1) / 2.0, (size[1] - 1) / 2.0),
        rotation_cam_enu=_make_rotation(tilt_deg=tilt, toward_deg=lean, turn_deg=float(rng.uniform(0.0, 360.0))),
        max_angle=math.radians(89.0 if projection == "perspective" else edge + 3.0),
    )
    longer = focal * (1.0 + rng.normal(0.0, 0.008))
    camera = replace(
        nominal,
        focal_length_px=(longer * stretch, longer),
        principal_point_px=tuple((np.array(nominal.principal_point_px) + offset).tolist()),
        decentering=(*(bent / (3.0 * focal * reach**2)).tolist(), 0.0, 0.0),
    )
    scale = wave_px * min(size) / _USUAL_PX * (6.0 if kind == "unknown" else 1.0)
    lobes = 2.0 * min(size) / _USUAL_PX if kind == "unknown" else 0.0
    nominal = _turn_camera(nominal, rng, _COMPASS_DEG)
    waves = _draw_displacement(rng, scale_px=scale, lobes_px=lobes, edge=math.radians(edge))
    return _Instrument(camera=camera, nominal=nominal, known=kind != "unknown", outwards_px=waves)


def _draw_displacement(
    rng: np.random.Generator, *, scale_px: float, lobes_px: float, edge: float
) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Draw a smooth displacement outwards: four cosines of the angle off the axis, three lobes about it."""
    # of what changes over half a radian at a right angle, and over less with a narrow lens
    rates = np.array([1.4, 2.2, 3.1, 4.3]) * (0.5 * math.pi / edge)
    heights, phases = rng.normal(0.0, scale_px / 2.0, 4), rng.uniform(0.0, 2.0 * math.pi, 4)
    lobe = float(rng.uniform(0.0, 2.0 * math.pi))

    def outwards(angle: FloatArray, about: FloatArray) -> FloatArray:
        here = np.cos(angle[..., None] * rates + phases) @ heights
        # nothing on the axis, where there is no outwards, and no share of the focal length
        start, slope = heights @ np.cos(phases), -(heights * rates) @ np.sin(phases)
        return np.asarray(here - start - slope * angle + lobes_px * (angle / edge) ** 3 * np.cos(3.0 * about - lobe))

    return outwards


def _make_rotation(*, tilt_deg: float, toward_deg: float, turn_deg: float) -> tuple[float, float, float]:
    # the axis leans towards the third angle, and the image is turned about it by the first
    return rotation_from_pose_angles(PoseAngles(phi_xz_deg=turn_deg, theta_zz_deg=tilt_deg, psi_z_deg=toward_deg))


def _turn_camera(camera: Camera, rng: np.random.Generator, degrees: float) -> Camera:
    axis = rng.normal(size=3)
    turn = rotation_matrix(math.radians(degrees) * axis / np.linalg.norm(axis))
    return replace(camera, rotation_cam_enu=rotation_vector(turn @ rotation_matrix(camera.rotation_cam_enu)))


def _draw_times(rng: np.random.Generator, site: Site, condition: str) -> FloatArray:
    """Draw the true times of the sightings: two days twelve apart, half a day or twenty minutes."""
    # from May to August in the north, from November to February in the south
    begin = 1_367_366_400.0 if site.latitude > 0.0 else 1_351_728_000.0
    day = 365.25 * float(rng.integers(0, 10)) // 1.0 + float(rng.integers(0, 100))
    noon = begin + DAY_S * day + 43_200.0 - 240.0 * site.longitude
    of_day = np.arange(-28_800.0, 28_800.0, _CADENCE_S)
    if condition == "half_day":
        of_day = of_day[of_day < 0.0] if rng.random() < 0.5 else of_day[of_day > 0.0]
        times = noon + of_day
    elif condition == "twenty_minutes":
        times = noon + rng.uniform(-10_000.0, 10_000.0) + np.arange(0.0, 1200.0, 30.0)
    else:
        times = (noon + np.array([[0.0], [12.0 * DAY_S]]) + of_day).ravel()
    return np.asarray(times[sun_directions(times, site)[:, 2] > math.sin(math.radians(_LOWEST_SUN_DEG))])


def _draw_sun_sightings(
    rng: np.random.Generator,
    times: FloatArray,
    site: Site,
    instruments: tuple[_Instrument, _Instrument],
    condition: str,
) -> Sightings:
    """Return a detector's record of the sun, by a camera and from some time on by another."""
    directions, (before, after) = sun_directions(times, site), instruments
    moves_at = rng.uniform(0.3, 0.7) * times.size if condition == "moved_mount" else 0.0
    first = np.arange(times.size) < moves_at
    pixels = np.where(first[:, None], before.sees(directions), after.sees(directions))
    unit = _SIGMA_PX * min(after.camera.width, after.camera.height) / _USUAL_PX
    noise = rng.normal(0.0, unit, pixels.shape)
    elevation = np.degrees(np.arcsin(directions[:, 2]))
    kept = np.ones(times.size, dtype=bool)
    if condition == "correlated":
        noise *= 1.3 * math.sqrt(1.0 - 0.81)
        for k in range(1, len(noise)):  # AR(1)
            noise[k] += 0.9 * noise[k - 1]
    elif condition == "cloud":
        noise, kept = _add_cloud_errors(rng, noise, unit)
    elif condition == "haze":
        # the lower edge fades first: the sun is found too high, the lower the more
        up = after.sees(_lift_directions(directions, 0.05)) - pixels
        noise = noise * (1.0 + 3.0 * np.exp(-elevation / 12.0))[:, None] + up * np.exp(-elevation / 6.0)[:, None]
        kept = rng.random(times.size) < np.clip(elevation / 10.0, 0.2, 1.0)
    recorded = times
    if condition == "drifting_clock":
        recorded = times + rng.uniform(-3.0, 3.0) + rng.uniform(-6.0, 6.0) * (times - times[:1]) / DAY_S / 12.0
    seen = pixels + noise
    kept &= _is_in_image(after.camera, seen)
    return Sightings.of(unix_s=recorded[kept], pixels=seen[kept], body=np.full(int(kept.sum()), SUN))


def _lift_directions(directions: FloatArray, degrees: float) -> FloatArray:
    zenith, azimuth = angles_from_direction(directions)
    return direction_from_angles(zenith_deg=np.maximum(zenith - degrees, 0.0), azimuth_deg=azimuth)


def _add_cloud_errors(rng: np.random.Generator, noise: FloatArray, unit: float) -> tuple[FloatArray, BoolArray]:
    """Return errors with episodes of cloud that draw detections to one side, a third of the time; and the rows kept."""
    count = noise.shape[0]
    covered, episode = np.zeros(count, dtype=bool), np.zeros_like(noise)
    while count and covered.mean() < 0.33:
        begin, length = int(rng.integers(count)), 2 + int(rng.geometric(0.1))
        part = slice(begin, begin + length)
        covered[part] = True
        episode[part] = 15.0 * unit * rng.standard_t(3, 2) + 5.0 * unit * rng.standard_t(3, noise[part].shape)
    return np.where(covered[:, None], noise + episode, noise), ~covered | (rng.random(count) < 0.6)


def _add_night_stars(rng: np.random.Generator, sightings: Sightings, site: Site, instrument: _Instrument) -> Sightings:
    """Return the sightings with those of stars in three images of the night after the last day, named."""
    evening = float(sightings.unix_s.max()) if len(sightings) else 0.0
    later = evening + np.arange(0.0, DAY_S, 600.0)
    dark = later[sun_directions(later, site)[:, 2] < math.cos(math.radians(_DARK_DEG))]
    if dark.size == 0:
        return sightings
    names: list[str] = [str(name) for name in sightings.body]
    times, pixels, directions = [sightings.unix_s], [sightings.pixels], [np.full((len(sightings), 3), np.nan)]
    sigma = [np.full(len(sightings), np.nan)]
    for moment in dark[np.linspace(0, dark.size - 1, 3).astype(int)].tolist():
        sky = night_sky(moment, site, faintest=_STAR_V)
        sky = sky.select(sky.directions[:, 2] > math.cos(math.radians(_STAR_ZENITH_DEG)))
        own = _STAR_SIGMA_PX * 2.0 ** (sky.magnitude / 3.0 - 1.0)
        seen = instrument.sees(sky.directions) + own[:, None] * rng.standard_normal((len(sky), 2))
        shown = _is_in_image(instrument.camera, seen) & (rng.random(len(sky)) > 0.1)
        names += [str(name) for name in sky.names[shown]]
        times.append(np.full(int(shown.sum()), moment))
        pixels.append(seen[shown])
        directions.append(sky.directions[shown])
        sigma.append(own[shown])
    body: NameArray = np.array(names, dtype=np.str_)
    return Sightings.of(
        unix_s=np.concatenate(times),
        pixels=np.concatenate(pixels),
        sigma_px=np.concatenate(sigma),
        directions=np.concatenate(directions),
        body=body,
    )


def _is_in_image(camera: Camera, pixels: FloatArray) -> BoolArray:
    inside = (pixels >= 0.0) & (pixels <= np.array([camera.width, camera.height]) - 1.0)
    return np.asarray(np.all(inside, axis=-1))


def _draw_truth(
    rng: np.random.Generator,
    instrument: _Instrument,
    sighted: FloatArray,
    *,
    kind: str,
    condition: str,
    answerable: bool,
) -> BenchmarkTruth:
    """Return the truth of pixels all over the sky that the camera sees."""
    spin, spread = rng.uniform(0.0, 2.0 * math.pi), hemisphere(6 * _QUERIES)
    cosine, sine = math.cos(spin), math.sin(spin)
    every = spread @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    seen = instrument.sees(every)
    slopes = np.stack([_pixels_per_degree(instrument, every, side) for side in neighbouring_directions(every)], axis=-1)
    rows = np.flatnonzero(_is_in_image(instrument.camera, seen) & np.all(np.isfinite(slopes), axis=(-2, -1)))
    rows = np.sort(rng.permutation(rows)[:_QUERIES])
    directions = every[rows]
    return BenchmarkTruth(
        lens=kind,
        condition=condition,
        answerable=answerable,
        pixels=seen[rows],
        directions=directions,
        track_deg=degrees_to_nearest(directions, sighted),
        px_per_deg=slopes[rows],
        fallback_deg=_nominal_error_deg(instrument, directions),
    )


def neighbouring_directions(directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return unit vectors (m, 3) from directions (m, 3) to larger zenith angles, and to larger azimuths."""
    zenith, azimuth = (np.radians(angle) for angle in angles_from_direction(directions))
    down = np.stack([np.cos(zenith) * np.sin(azimuth), np.cos(zenith) * np.cos(azimuth), -np.sin(zenith)], axis=-1)
    return down, np.stack([np.cos(azimuth), -np.sin(azimuth), np.zeros_like(azimuth)], axis=-1)


def _pixels_per_degree(instrument: _Instrument, directions: FloatArray, side: FloatArray) -> FloatArray:
    """Return (m, 2): px a degree by a change of directions (m, 3) to a side (m, 3)."""
    ends = [instrument.sees(_normalize_rows(directions + sign * _STEP * side)) for sign in (1.0, -1.0)]
    return np.asarray((ends[0] - ends[1]) / (2.0 * math.degrees(_STEP)))


def _nominal_error_deg(instrument: _Instrument, directions: FloatArray) -> FloatArray:
    """Return the error (m,), degrees, of the nominal camera: its pixel's distance by its own scale there."""
    nominal = replace(instrument.nominal, max_angle=math.pi)
    beside = _normalize_rows(directions + _STEP * tangent_basis(directions)[..., 0])
    here = project(nominal, directions)
    scale = np.linalg.norm(project(nominal, beside) - here, axis=-1) / math.degrees(_STEP)
    error = np.linalg.norm(here - instrument.sees(directions), axis=-1) / np.maximum(scale, 1e-9)
    # beyond the nominal lens's field nothing is said: the mount alone is off by 5 degrees
    return np.clip(np.where(np.isfinite(error), error, _COMPASS_DEG), 0.0, 90.0)


def degrees_to_nearest(directions: FloatArray, sighted: FloatArray) -> FloatArray:
    """Return (m,): degrees from directions (m, 3) to the nearest of others (n, 3); 180 without others."""
    known = sighted[np.all(np.isfinite(sighted), axis=-1)]
    if known.shape[0] == 0:
        return np.full(directions.shape[0], 180.0)
    return np.asarray(np.degrees(np.arccos(np.clip((directions @ known.T).max(axis=-1), -1.0, 1.0))))


def _normalize_rows(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
