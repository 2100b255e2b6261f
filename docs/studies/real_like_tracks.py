"""One-camera sun tracks as they come from real all-sky imagers, with the truth behind them.

Shared with the fit: the sun's ephemeris and the five ideal projections' formulas (written again here). Not shared: the
radial residual is a cubic spline through random knots, the rest of the lens a small field of cosines, the noise is
first-order autoregressive, grows to the horizon and has a few gross errors; cloud draws the detections aside by a
vector that grows, turns and vanishes within minutes to an hour.

    from real_like_tracks import real_like_track
    track = real_like_track(7)                    # everything drawn from the seed
    track = real_like_track(7, move_deg=0.4)      # the same camera, turned by 0.4 degrees within the track
    calibrate(track.points, site=track.site, image_size=track.image_size, options=track.options)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.optics.projections import Projection
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Cloud = Literal["none", "middle", "start", "end", "both"]

_NEW_YEAR_2016 = 1_451_606_400.0
_RADIUS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "equidistant": lambda theta: theta,
    "equisolid": lambda theta: 2.0 * np.sin(0.5 * theta),
    "stereographic": lambda theta: 2.0 * np.tan(0.5 * theta),
    "orthographic": np.sin,
    "perspective": np.tan,
}
_LARGEST_DEG = {
    "equidistant": 95.0,
    "equisolid": 95.0,
    "stereographic": 95.0,
    "orthographic": 82.0,
    "perspective": 60.0,
}
"""Angle off the axis at the edge of the image circle, degrees."""
_SIZES = ((1920, 1920), (1748, 1748), (2048, 1536), (1280, 960), (2592, 1944))
_FEWEST = 60
_SMALLEST_ARC_DEG = 25.0
_DRAWS = 200


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lens:
    """A lens that is nearly one of the ideal projections.

    Attributes
    ----------
    projection : the ideal projection.
    focal_px, center_px : px.
    residual_px : the radial residual over the angle off the axis in radians, px; a cubic spline where it is drawn.
    waves : (2, k, 4) amplitude in px, wave vector in 1/px and phase of the displacement field, for x and y.
    """

    projection: Projection
    focal_px: float
    center_px: tuple[float, float]
    residual_px: Callable[[FloatArray], FloatArray]
    waves: FloatArray

    def project(self, rays: FloatArray) -> FloatArray:
        """Return pixels (n, 2) of unit vectors (n, 3) in the camera's frame; NaN outside of the image circle."""
        theta = np.arccos(np.clip(rays[:, 2], -1.0, 1.0))
        inside = theta <= math.radians(_LARGEST_DEG[self.projection])
        theta = np.where(inside, theta, 0.0)
        radius = self.focal_px * _RADIUS[self.projection](theta) + self.residual_px(theta)
        unit = rays[:, :2] / np.maximum(np.linalg.norm(rays[:, :2], axis=-1), 1e-12)[:, None]
        pixels = np.array(self.center_px) + radius[:, None] * unit
        shift = [np.sum(w[:, 0] * np.cos(pixels @ w[:, 1:3].T + w[:, 3]), axis=-1) for w in self.waves]
        return np.where(inside[:, None], pixels + np.stack(shift, axis=-1), np.nan)


@dataclass(frozen=True, slots=True, kw_only=True)
class Draw:
    """What a track has; None is drawn from the seed.

    Attributes
    ----------
    projection : the ideal projection of the lens.
    cloud : where cloud draws detections aside.
    thin : every n-th sighting is kept.
    half_day : only the morning or the afternoon.
    gaps : sightings are missing for minutes to hours.
    rounded : whole pixels.
    tilt_deg : angle between the optical axis and the vertical.
    cadence_s : seconds between sightings.
    days : consecutive days.
    move_deg : the camera turns by so much within the track; 0 is no move.
    """

    projection: Projection | None = None
    cloud: Cloud | None = None
    thin: int | None = None
    half_day: bool | None = None
    gaps: bool | None = None
    rounded: bool | None = None
    tilt_deg: float | None = None
    cadence_s: float = 60.0
    days: int = 1
    move_deg: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Track:
    """Sightings, and the truth behind them.

    Attributes
    ----------
    points : the sightings, in the order of time; all of one epoch.
    drawn : what the track has, nothing of it None.
    clouded : (n,) which sightings cloud drew aside.
    wrong : (n,) gross errors.
    sigma_px : noise per axis overhead, px.
    turns : rotations from east-north-up to the camera, one a pose.
    moved_at : unix seconds of the move, infinite without.
    """

    points: Sightings
    site: Site
    image_size: tuple[int, int]
    drawn: Draw
    lens: Lens
    turns: tuple[Rotation, ...]
    moved_at: float
    clouded: BoolArray
    wrong: BoolArray
    sigma_px: float
    options: CalibrationOptions = field(default_factory=CalibrationOptions)

    def true_pixels(self, directions: FloatArray, *, pose: int = -1) -> FloatArray:
        """Return where directions (n, 3) land, px: by the last pose, or another."""
        return self.lens.project(self.turns[pose].apply(directions))

    def with_pixels(self, pixels: FloatArray) -> Track:
        """Return the track with other pixels."""
        return replace(self, points=replace(self.points, pixels=pixels))


def real_like_track(seed: int, draw: Draw | None = None, **fixed: object) -> Track:
    """Return the track of a seed; the same seed and draw give the same track.

    Parameters
    ----------
    seed : another seed is another camera, place, season and sky.
    draw : what is not left to the seed; `fixed` are fields of `Draw`.
    """
    wanted = replace(Draw() if draw is None else draw, **fixed)  # type: ignore[arg-type]
    rng = np.random.default_rng((20160830, seed))
    for _ in range(_DRAWS):
        track = _drawn(rng, wanted)
        if track is not None:
            return track
    raise ValueError(f"no track with {wanted} shows the sun long enough")


def _drawn(rng: np.random.Generator, wanted: Draw) -> Track | None:
    """Return one attempt; None where too little of the sun's way lies in the image."""
    draw = _completed(rng, wanted)
    size = _SIZES[rng.integers(len(_SIZES))]
    lens = random_lens(rng, draw.projection or "equidistant", size)
    site = _site(rng)
    turns, times = _turns(rng, draw, site), _times(rng, draw, site)
    moved_at = math.inf
    if len(turns) > 1 and times.size:
        moved_at = float(times[round(rng.uniform(0.25, 0.75) * (times.size - 1))])
    directions = sun_directions(times, site)
    after = times >= moved_at
    poses = [lens.project(turn.apply(directions)) for turn in turns] if times.size else [np.zeros((0, 2))]
    pixels = np.where(after[:, None], poses[-1], poses[0])
    inside = np.all((pixels > 2.0) & (pixels < np.array(size) - 3.0), axis=-1)
    times, directions, pixels = times[inside], directions[inside], pixels[inside]
    sides = [int(np.sum(times < moved_at)), int(np.sum(times >= moved_at))][: len(turns)]
    if min(sides) < _FEWEST or _arc_deg(directions) < _SMALLEST_ARC_DEG:
        return None
    sigma = float(rng.uniform(0.3, 0.9))
    noise, wrong = _noise(rng, directions, sigma)
    bias, clouded = _cloud(rng, draw.cloud or "none", times)
    seen = pixels + noise + bias
    seen = np.rint(seen) if draw.rounded else seen
    kept = slice(None, None, draw.thin)
    return Track(
        points=Sightings.of(unix_s=times[kept], pixels=seen[kept]),
        site=site,
        image_size=size,
        drawn=draw,
        lens=lens,
        turns=turns,
        moved_at=moved_at,
        clouded=clouded[kept],
        wrong=wrong[kept],
        sigma_px=sigma,
        options=CalibrationOptions(projection=lens.projection, level_within_deg=60.0),
    )


def _site(rng: np.random.Generator) -> Site:
    latitude = float(rng.choice([-45.0, -20.0, 5.0, 25.0, 36.6, 47.0, 54.5, 65.0]) + rng.uniform(-3.0, 3.0))
    return Site(latitude=latitude, longitude=float(rng.uniform(-170.0, 170.0)), altitude=float(rng.uniform(0, 2000)))


def _completed(rng: np.random.Generator, wanted: Draw) -> Draw:
    """Return the draw with nothing left open; the same numbers are drawn whatever is given."""
    clouds: tuple[Cloud, ...] = ("none", "middle", "start", "end", "both")
    projections: tuple[Projection, ...] = ("equidistant", "equisolid", "stereographic", "orthographic", "perspective")
    drawn = Draw(
        projection=projections[rng.choice(5, p=[0.35, 0.25, 0.15, 0.15, 0.10])],
        cloud=clouds[rng.choice(5, p=[0.2, 0.35, 0.15, 0.15, 0.15])],
        thin=int(rng.choice([1, 1, 1, 2, 3, 4])),
        half_day=bool(rng.random() < 0.25),
        gaps=bool(rng.random() < 0.3),
        rounded=bool(rng.random() < 0.25),
        tilt_deg=float(rng.choice([rng.uniform(0.0, 4.0), rng.uniform(0.0, 50.0)], p=[0.6, 0.4])),
    )
    names = ("projection", "cloud", "thin", "half_day", "gaps", "rounded", "tilt_deg")
    chosen = {name: getattr(wanted, name) for name in names if getattr(wanted, name) is not None}
    return replace(drawn, **chosen, cadence_s=wanted.cadence_s, days=wanted.days, move_deg=wanted.move_deg)


def random_lens(rng: np.random.Generator, projection: Projection, size: tuple[int, int]) -> Lens:
    """Draw a lens whose image circle about fills the shorter side of an image."""
    edge = math.radians(_LARGEST_DEG[projection])
    focal = 0.5 * min(size) * float(rng.uniform(0.85, 1.15)) / float(_RADIUS[projection](np.array(edge)))
    center = (0.5 * size[0] + rng.normal(0.0, 12.0), 0.5 * size[1] + rng.normal(0.0, 12.0))
    knots = np.linspace(0.0, edge, 5)
    largest = float(rng.choice([rng.uniform(0.0, 3.0), rng.uniform(0.0, 20.0)])) * min(size) / 1920.0
    heights = rng.standard_normal(5) * np.linspace(0.0, 1.0, 5)
    heights *= largest / max(float(np.max(np.abs(heights))), 1e-9)
    waves = np.zeros((2, 24, 4))
    waves[..., 0] = float(rng.uniform(0.0, 0.4)) * math.sqrt(2.0 / 24.0)
    waves[..., 1:3] = rng.standard_normal((2, 24, 2)) / (0.3 * min(size))
    waves[..., 3] = rng.uniform(0.0, 2.0 * math.pi, (2, 24))
    return Lens(
        projection=projection,
        focal_px=focal,
        center_px=center,
        residual_px=CubicSpline(knots, heights, bc_type=("clamped", "natural")),
        waves=waves,
    )


def _turns(rng: np.random.Generator, draw: Draw, site: Site) -> tuple[Rotation, ...]:
    """Return the pose, and the one after a move: a camera that leans leans to where the sun is."""
    tilt = float(draw.tilt_deg or 0.0)
    toward = (180.0 if site.latitude > 0.0 else 0.0) + rng.uniform(-90.0, 90.0)
    east, north = math.sin(math.radians(toward)), math.cos(math.radians(toward))
    lean = Rotation.from_rotvec(math.radians(tilt) * np.array([north, -east, 0.0]))
    first = Rotation.from_euler("z", rng.uniform(0.0, 360.0), degrees=True) * lean
    axis = rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    if draw.move_deg == 0.0:
        return (first,)
    return first, Rotation.from_rotvec(math.radians(draw.move_deg) * axis) * first


def _times(rng: np.random.Generator, draw: Draw, site: Site) -> FloatArray:
    """Return the times with the sun up that the detector gave something for."""
    day = float(rng.integers(0, 366))
    noon = _NEW_YEAR_2016 + 86_400.0 * day + 43_200.0 - site.longitude * 240.0
    lowest = float(rng.uniform(75.0, 89.0))
    half = (0.0, 43_200.0) if rng.random() < 0.5 else (-43_200.0, 0.0)
    first, last = half if draw.half_day else (-43_200.0, 43_200.0)
    missing = float(rng.choice([0.0, 0.02, 0.15]))
    parts = []
    for number in range(draw.days):
        times = np.floor(noon + 86_400.0 * number + np.arange(first, last, draw.cadence_s))
        times = times[sun_angles(times, site).apparent_zenith < lowest]
        kept = rng.random(times.size) >= missing
        if draw.gaps and times.size:
            for _ in range(int(rng.integers(1, 4))):
                begin, long = rng.uniform(times[0], times[-1]), rng.uniform(600.0, 7200.0)
                kept &= (times < begin) | (times > begin + long)
        parts.append(times[kept])
    return np.concatenate(parts)


def _arc_deg(directions: FloatArray) -> float:
    step = np.linalg.norm(np.diff(directions, axis=0), axis=-1)
    return math.degrees(float(np.sum(step[step < math.radians(5.0)])))


def _noise(rng: np.random.Generator, directions: FloatArray, sigma_px: float) -> tuple[FloatArray, BoolArray]:
    """Return correlated noise that is twice as large at the horizon, (n, 2) px, and which sightings are wrong."""
    n, low = directions.shape[0], 1.0 - directions[:, 2]
    noise = _correlated(rng, n, float(rng.uniform(0.2, 0.85))) * (sigma_px * (1.0 + low**2))[:, None]
    wrong = rng.random(n) < rng.choice([0.0, 0.01, 0.03])
    noise[wrong] += rng.uniform(-60.0, 60.0, (int(wrong.sum()), 2))
    return noise, wrong


def _correlated(rng: np.random.Generator, n: int, rho: float) -> FloatArray:
    """Draw first-order autoregressive noise of unit variance, (n, 2)."""
    drawn = rng.standard_normal((n, 2))
    for i in range(1, n):
        drawn[i] = rho * drawn[i - 1] + math.sqrt(1.0 - rho**2) * drawn[i]
    return drawn


def _cloud(rng: np.random.Generator, where: Cloud, times: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the displacement by cloud, (n, 2) px, and which sightings have one."""
    bias, any_cloud = np.zeros((times.size, 2)), np.zeros(times.size, dtype=bool)
    places = {"none": (), "middle": ("middle",), "start": ("start",), "end": ("end",), "both": ("start", "middle")}
    for place in places[where]:
        long = float(rng.uniform(300.0, 3600.0))
        begin = {
            "start": times[0] - rng.uniform(0.0, 0.3) * long,
            "middle": rng.uniform(times[0] + 0.15 * np.ptp(times), times[-1] - 0.15 * np.ptp(times) - long),
            "end": times[-1] - rng.uniform(0.7, 1.0) * long,
        }[place]
        mine = (times >= begin) & (times <= begin + long)
        bias[mine] += drawn_aside(rng, (times[mine] - begin) / long, float(rng.uniform(3.0, 10.0)))
        any_cloud |= mine
    return bias, any_cloud


def drawn_aside(rng: np.random.Generator, share: FloatArray, largest_px: float) -> FloatArray:
    """Return a vector (n, 2) px that drifts while an episode's share (n,) goes from 0 to 1.

    It grows to `largest_px`, slowly turns, and vanishes smoothly or at once.
    """
    shapes = (np.sin(math.pi * share), share, 1.0 - share, 0.6 + 0.4 * np.sin(math.pi * share))
    angle = rng.uniform(0.0, 2.0 * math.pi) + rng.uniform(-1.0, 1.0) * share
    length = largest_px * shapes[rng.integers(len(shapes))]
    return np.asarray(length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
