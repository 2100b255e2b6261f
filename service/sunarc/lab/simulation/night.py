"""The light of the night on the sensor: stars, planets, moon, glow, trails, and pixels that only look like stars."""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sunarc import _kernels
from sunarc.common.array_types import FloatArray
from sunarc.common.utc import DAY_S
from sunarc.lab.simulation.options import Obstruction, SimulatedNight
from sunarc.lab.simulation.scene_parts import CloudLayer, RegionLight, disc_points, is_blocked
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.night import FAINTEST_V, SOLAR_SYSTEM_BODIES, BodyPosition, body_position, star_table
from sunarc.sky.refraction import apparent_elevation
from sunarc.sky.site import Site, relative_air_mass
from sunarc.sky.sun import sun_angles

_TABLE_YEAR_UNIX_S = 1_704_067_200.0
"""The start of 2024, the epoch of the table's places."""
_YEAR_S = 365.25 * DAY_S
_COUNT_SLOPE = 0.49
"""Of the number of stars to a magnitude, in powers of ten a magnitude (the sky's between V 5 and 8)."""
_ARCSEC_PER_RAD = 206_264.806
_FULL_MOON, _MOONLIT_SKY = -12.7, 18.2
"""V of the full moon, and of a square arcsecond of the sky far from it (K. Krisciunas and B. Schaefer 1991)."""
_GLARE = 2e-6
"""Light scattered in the lens one degree from a source, of one square pixel over all of the source's."""
_BLOBS = np.array([[0.62, 0.0, 1.0], [0.26, 1.0, 1.4], [0.12, 2.0, 1.9]])
"""A star's image as three Gaussians: shares, places along the coma and widths over the first one's. Their centre of
light is the star's place, as the sun's is its disc's centre."""
_SIGMA_PX, _SIGMA_AT_EDGE_PX = 0.8, 0.5
_TRAIL_STEP_PX = 0.3
_EDGE_RAD = math.radians(90.0)


class NightLight:
    """The light of one camera's nights, the same for the same moment.

    Parameters
    ----------
    camera, site : of the scene.
    options : what shines.
    seed : draws faint stars, twinkling, trails and warm pixels.
    obstructions : what stands before the sky.
    """

    def __init__(
        self,
        camera: Camera,
        site: Site,
        *,
        options: SimulatedNight,
        seed: int,
        obstructions: tuple[Obstruction, ...] = (),
    ) -> None:
        self._camera = camera
        self._site = site
        self._options = options
        self._seed = seed
        self._obstructions = obstructions
        self._middle = np.array(camera.principal_point_px)
        self._edge_px = _EDGE_RAD * camera.focal_length_px[0] * 0.9

    def add(self, region: RegionLight, *, unix_s: float, exposure_us: float, layer: CloudLayer, well_e: float) -> None:
        """Add the night to the light of a region, in full scales per microsecond.

        Parameters
        ----------
        region : what the light is added to.
        unix_s, exposure_us : middle of the exposure and its length.
        layer : the clouds.
        well_e : electrons of a full scale.
        """
        scale = 1e-6 / well_e
        rng = np.random.default_rng([self._seed, 17, round(unix_s * 1e3)])
        moon = body_position("moon", unix_s, self._site) if self._options.moon else None
        light = region.light
        light += _kernels.night_glow(region.field, *self._compute_glow(moon, scale), *layer)
        points = [
            self._make_point_images(*self._place_stars(unix_s, exposure_us, rng, layer)),
            self._make_point_images(*self._place_planets(unix_s, layer)),
            self._make_point_images(*self._draw_trails(exposure_us, rng, layer)),
            self._place_moon(moon, unix_s, layer),
            self._draw_warm_pixels(),
        ]
        every = np.concatenate(points)
        every[:, :2] -= region.origin
        every[:, 2] *= scale
        light += _kernels.image_of_points(light.shape[0], light.shape[1], every)

    def _compute_glow(
        self, moon: BodyPosition | None, scale: float
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Return the levels, the town's direction and the moon's, of `night_glow`."""
        options = self._options
        pixel_arcsec2 = (_ARCSEC_PER_RAD / self._camera.focal_length_px[0]) ** 2
        zero = options.star_e_per_s * scale
        per_magnitude = [zero * pixel_arcsec2 * 10.0 ** (-0.4 * one) for one in (options.airglow, options.city)]
        moonlit, glare, direction = 0.0, 0.0, (0.0, 0.0, -1.0)
        if moon is not None and moon.direction[2] > 0.0:
            direction = moon.direction
            through = self._compute_transmission(np.array([moon.direction]))[0]
            relative = 10.0 ** (-0.4 * (moon.magnitude - _FULL_MOON)) * through
            moonlit = zero * pixel_arcsec2 * 10.0 ** (-0.4 * _MOONLIT_SKY) * relative
            glare = zero * 10.0 ** (-0.4 * moon.magnitude) * through * _GLARE
        azimuth = math.radians(options.city_azimuth_deg)
        return (
            np.array([*per_magnitude, moonlit, glare], dtype=np.float32),
            np.array([math.sin(azimuth), math.cos(azimuth)], dtype=np.float32),
            np.array(direction, dtype=np.float32),
        )

    @cached_property
    def _make_catalogue(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """ICRS unit vectors (n, 3), their motion a year (n, 3), and V: the table's stars, and faint ones at random."""
        table = star_table()
        right, up = table.right_ascension, table.declination
        place = _unit_vectors(right, up)
        east = np.stack([-np.sin(right), np.cos(right), np.zeros_like(right)], axis=-1)
        north = np.stack([-np.cos(right) * np.sin(up), -np.sin(right) * np.sin(up), np.cos(up)], axis=-1)
        motion = np.nan_to_num(table.motion)
        bright = table.magnitude <= self._options.faintest
        rng = np.random.default_rng([self._seed, 13])
        growth = 10.0 ** (_COUNT_SLOPE * max(self._options.faintest - FAINTEST_V, 0.0))
        faint = int(bright.sum() * (growth - 1.0))
        magnitude = FAINTEST_V + np.log10(rng.uniform(1.0, growth, faint)) / _COUNT_SLOPE
        anywhere = rng.standard_normal((faint, 3))
        return (
            np.concatenate([place[bright], anywhere / np.linalg.norm(anywhere, axis=-1, keepdims=True)]),
            np.concatenate([(east * motion[:, :1] + north * motion[:, 1:])[bright], np.zeros((faint, 3))]),
            np.concatenate([table.magnitude[bright], magnitude]),
        )

    def _place_stars(
        self, unix_s: float, exposure_us: float, rng: np.random.Generator, layer: CloudLayer
    ) -> tuple[FloatArray, FloatArray]:
        """Return pixels (n, steps, 2) along the trails and electrons a second (n,) of the stars in the image."""
        place, motion, magnitude = self._make_catalogue
        place = place + motion * ((unix_s - _TABLE_YEAR_UNIX_S) / _YEAR_S)
        ends = [
            star_directions_by_series(place, unix_s + side * exposure_us * 0.5e-6, self._site) for side in (-1.0, 1.0)
        ]
        direction = 0.5 * (ends[0] + ends[1])
        electrons = (
            self._options.star_e_per_s * 10.0 ** (-0.4 * magnitude) * self._compute_transmission(direction, layer)
        )
        seen = electrons > 0.0
        pixels = np.stack([self._project(one[seen]) for one in ends], axis=1)
        air_mass = relative_air_mass(np.degrees(np.arccos(np.clip(direction[seen, 2], 0.0, 1.0))))
        spread = np.log1p(self._options.twinkle * np.minimum(air_mass, 10.0) ** 0.9)
        flicker = np.exp(spread * rng.standard_normal(spread.size) - 0.5 * spread**2)
        inside = np.all(np.isfinite(pixels), axis=(1, 2))
        longest = float(np.max(np.linalg.norm(pixels[inside, 1] - pixels[inside, 0], axis=-1), initial=0.0))
        steps = (np.arange(count := math.ceil(longest / _TRAIL_STEP_PX) + 1) + 0.5) / count
        trail = pixels[inside, :1] + steps[None, :, None] * (pixels[inside, 1:] - pixels[inside, :1])
        return trail, (electrons[seen] * flicker)[inside]

    def _place_planets(self, unix_s: float, layer: CloudLayer) -> tuple[FloatArray, FloatArray]:
        if not self._options.moon:
            return np.zeros((0, 1, 2)), np.zeros(0)
        places = [body_position(name, unix_s, self._site) for name in SOLAR_SYSTEM_BODIES if name != "moon"]
        direction = np.array([place.direction for place in places])
        magnitude = np.array([place.magnitude for place in places])
        electrons = (
            self._options.star_e_per_s * 10.0 ** (-0.4 * magnitude) * self._compute_transmission(direction, layer)
        )
        pixels = self._project(direction)
        seen = np.all(np.isfinite(pixels), axis=-1) & (electrons > 0.0)
        return pixels[seen, None], electrons[seen]

    def _draw_trails(
        self, exposure_us: float, rng: np.random.Generator, layer: CloudLayer
    ) -> tuple[FloatArray, FloatArray]:
        """Return pixels (n, 1, 2) and electrons a second (n,) of satellites (even trails) and aircraft (flashes)."""
        places, light = [np.zeros((0, 2))], [np.zeros(0)]
        for kind, mean in (("satellite", self._options.satellites), ("aircraft", self._options.aircraft)):
            for _ in range(rng.poisson(mean)):
                start = direction_from_angles(
                    zenith_deg=math.degrees(math.acos(rng.uniform(0.2, 0.98))), azimuth_deg=rng.uniform(0.0, 360.0)
                )
                heading = np.cross(start, rng.standard_normal(3))
                heading /= np.linalg.norm(heading)
                length = math.radians(rng.uniform(0.2, 1.0)) * exposure_us * 1e-6
                count = max(int(length * self._camera.focal_length_px[0] / _TRAIL_STEP_PX), 2)
                share = np.linspace(0.0, 1.0, count)
                if kind == "aircraft":
                    share = share[share * exposure_us * 1e-6 % 1.0 < 0.1]  # a flash a second
                way = np.cos(share * length)[:, None] * start
                way = way + np.sin(share * length)[:, None] * heading
                # a point of a trail has the light of the time that it was lit
                brightest = -3.0 if kind == "aircraft" else 0.0
                electrons = self._options.star_e_per_s * 10.0 ** (-0.4 * rng.uniform(brightest, brightest + 4.0))
                places.append(self._project(way))
                light.append(electrons / max(share.size, 1) * self._compute_transmission(way, layer))
        pixels, electrons_per_s = np.concatenate(places), np.concatenate(light)
        seen = np.all(np.isfinite(pixels), axis=-1) & (electrons_per_s > 0.0)
        return pixels[seen, None], electrons_per_s[seen]

    def _place_moon(self, moon: BodyPosition | None, unix_s: float, layer: CloudLayer) -> FloatArray:
        """Return the moon's lit part as points of `image_of_points`."""
        if moon is None:
            return np.zeros((0, 4))
        direction = np.array(moon.direction)
        through = float(self._compute_transmission(direction[None], layer)[0])
        points = disc_points(self._camera, direction, limb_darkening=0.0, radius=moon.radius)
        if points is None or through <= 0.0:
            return np.zeros((0, 4))
        angles = sun_angles(unix_s, self._site)
        sun = direction_from_angles(zenith_deg=angles.zenith, azimuth_deg=angles.azimuth)
        offset = points.direction_enu - direction
        offset /= np.max(np.linalg.norm(offset, axis=-1)) * 1.001
        outwards = offset - np.sqrt(1.0 - np.sum(offset**2, axis=-1))[:, None] * direction
        lit = points.weight_px * np.maximum(outwards @ sun, 0.0)
        if not np.any(lit > 0.0):
            return np.zeros((0, 4))
        electrons = self._options.star_e_per_s * 10.0 ** (-0.4 * moon.magnitude) * through * lit / lit.sum()
        bright = electrons > 0.0
        return np.column_stack([points.pixel[bright], electrons[bright], np.full(int(bright.sum()), _SIGMA_PX)])

    def _draw_warm_pixels(self) -> FloatArray:
        """Return the clumps of warm pixels as points (n, 4): the same in every image."""
        count = self._options.warm_spots
        rng = np.random.default_rng([self._seed, 19])
        place = rng.uniform(0.0, 1.0, (count, 2)) * [self._camera.width, self._camera.height]
        return np.column_stack([place, 10.0 ** rng.uniform(1.5, 3.5, count), np.full(count, _SIGMA_PX)])

    def _make_point_images(self, pixels: FloatArray, electrons: FloatArray) -> FloatArray:
        """Return the images of sources along their trails, pixels (n, steps, 2), as points of `image_of_points`."""
        steps = pixels.shape[1]
        every = pixels.reshape(-1, 2)
        light = np.repeat(electrons / max(steps, 1), steps)
        outwards = every - self._middle
        far = np.linalg.norm(outwards, axis=-1, keepdims=True)
        edge = (far / self._edge_px) ** 2
        outwards = outwards / np.maximum(far, 1e-9) * (self._options.coma_px * edge)
        mean = float(_BLOBS[:, 0] @ _BLOBS[:, 1])
        sigma = _SIGMA_PX + _SIGMA_AT_EDGE_PX * edge[:, 0]
        return np.concatenate(
            [
                np.column_stack([every + (place - mean) * outwards, share * light, width * sigma])
                for share, place, width in _BLOBS
            ]
        )

    def _project(self, direction: FloatArray) -> FloatArray:
        return project(self._camera, direction)

    def _compute_transmission(self, direction: FloatArray, layer: CloudLayer | None = None) -> FloatArray:
        """Return the share of light that comes through air, clouds and obstructions; 0 below the horizon."""
        zenith = np.degrees(np.arccos(np.clip(direction[:, 2], -1.0, 1.0)))
        through = 10.0 ** (-0.4 * self._options.extinction * relative_air_mass(np.minimum(zenith, 89.9)))
        if layer is not None and layer.transmittance.shape[0] > 1:
            through *= _kernels.cloud_transmittance(*layer, direction.astype(np.float32))
        axis = rotation_matrix(self._camera.rotation_cam_enu)[2]
        hidden = is_blocked(direction, self._obstructions) | (direction @ axis < math.cos(self._camera.max_angle))
        return np.where(hidden, 0.0, through)


def _unit_vectors(right: FloatArray, up: FloatArray) -> FloatArray:
    """Return unit vectors (n, 3) of right ascensions and declinations, rad."""
    return np.stack([np.cos(up) * np.cos(right), np.cos(up) * np.sin(right), np.sin(up)], axis=-1)


# Apparent directions of stars by textbook series, not by `sunarc.sky.night`, which the simulator puts to the test.
#
# References: N. Capitaine, P. Wallace, J. Chapront, "Expressions for IAU 2000 precession quantities", Astronomy and
# Astrophysics 412 (2003), as adopted by the IAU in 2006 (precession); J. Meeus, "Astronomical Algorithms" (1998),
# chapters 12 (sidereal time), 22 (nutation, four terms: 0.5 arcseconds) and 23 (aberration).

_J2000_UNIX_S = 946_728_000.0
_TT_MINUS_UTC_S = 69.184
_CENTURY_DAYS = 36_525.0
_ABERRATION_RAD = math.radians(20.49552 / 3600.0)
_PERIHELION_RAD = math.radians(102.937)


class _AstronomicalTerms(NamedTuple):
    """Obliquity, nutation in longitude and in obliquity, true longitude of the sun, rad; the orbit's eccentricity."""

    obliquity: float
    in_longitude: float
    in_obliquity: float
    sun: float
    eccentricity: float


def star_directions_by_series(places_icrs: FloatArray, unix_s: float, site: Site) -> FloatArray:
    """Return the apparent directions (n, 3), east-north-up, of ICRS unit vectors (n, 3) at one moment.

    With annual aberration, precession, nutation and the refraction of the sun's algorithm; within an arcsecond.
    Proper motion is the caller's.
    """
    days = (unix_s - _J2000_UNIX_S) / DAY_S
    centuries = (days + _TT_MINUS_UTC_S / DAY_S) / _CENTURY_DAYS
    terms = _compute_terms(centuries)
    aberrated = places_icrs + _earth_velocity(terms)
    aberrated /= np.linalg.norm(aberrated, axis=-1, keepdims=True)
    of_date = aberrated @ (_nutation_matrix(terms) @ _precession_matrix(centuries)).T
    sidereal = math.radians(280.46061837 + 360.98564736629 * days + 0.000387933 * centuries**2)
    sidereal += terms.in_longitude * math.cos(terms.obliquity) + math.radians(site.longitude)
    towards_east, latitude = _axis_rotation(2, sidereal) @ of_date.T, math.radians(site.latitude)
    south_of_zenith = _axis_rotation(1, math.pi / 2.0 - latitude) @ towards_east
    north, east, up = -south_of_zenith[0], south_of_zenith[1], south_of_zenith[2]
    elevation = apparent_elevation(np.degrees(np.arcsin(np.clip(up, -1.0, 1.0))), site)
    azimuth = np.degrees(np.arctan2(east, north))
    return direction_from_angles(zenith_deg=90.0 - elevation, azimuth_deg=azimuth)


def _compute_terms(centuries: float) -> _AstronomicalTerms:
    t = centuries
    node, sun, moon = (
        math.radians(first + rate * t)
        for first, rate in ((125.04452, -1934.136261), (280.46646, 36000.76983), (218.3165, 481267.8813))
    )
    anomaly = math.radians(357.52911 + 35999.05029 * t)
    centre = 1.914602 * math.sin(anomaly) + 0.019993 * math.sin(2.0 * anomaly) + 0.000289 * math.sin(3.0 * anomaly)
    longitude = (
        -17.20 * math.sin(node) - 1.32 * math.sin(2 * sun) - 0.23 * math.sin(2 * moon) + 0.21 * math.sin(2 * node)
    )
    tilt = 9.20 * math.cos(node) + 0.57 * math.cos(2 * sun) + 0.10 * math.cos(2 * moon) - 0.09 * math.cos(2 * node)
    # the velocity is wanted in the frame of J2000, the sun's longitude is of the date
    precessed = math.radians(1.396971 * t)
    return _AstronomicalTerms(
        obliquity=math.radians((84381.406 - 46.836769 * t) / 3600.0),
        in_longitude=math.radians(longitude / 3600.0),
        in_obliquity=math.radians(tilt / 3600.0),
        sun=sun + math.radians(centre) - precessed,
        eccentricity=0.016708634 - 0.000042037 * t,
    )


def _earth_velocity(terms: _AstronomicalTerms) -> FloatArray:
    """Return the Earth's velocity over light's, (3,), in the frame of J2000."""
    along = math.cos(terms.sun) - terms.eccentricity * math.cos(_PERIHELION_RAD)
    across = math.sin(terms.sun) - terms.eccentricity * math.sin(_PERIHELION_RAD)
    obliquity = terms.obliquity
    return _ABERRATION_RAD * np.array([across, -along * math.cos(obliquity), -along * math.sin(obliquity)])


def _precession_matrix(t: float) -> FloatArray:
    zeta = 2.650545 + (2306.083227 + (0.2988499 + 0.01801828 * t) * t) * t
    z = -2.650545 + (2306.077181 + (1.0927348 + 0.01826837 * t) * t) * t
    theta = (2004.191903 - (0.4294934 + 0.04182264 * t) * t) * t
    first, second, third = (math.radians(angle / 3600.0) for angle in (-zeta, theta, -z))
    return _axis_rotation(2, third) @ _axis_rotation(1, second) @ _axis_rotation(2, first)


def _nutation_matrix(terms: _AstronomicalTerms) -> FloatArray:
    true = terms.obliquity + terms.in_obliquity
    return _axis_rotation(0, -true) @ _axis_rotation(2, -terms.in_longitude) @ _axis_rotation(0, terms.obliquity)


def _axis_rotation(axis: int, angle: float) -> FloatArray:
    """Return the matrix (3, 3) that turns the frame about an axis by an angle, rad."""
    c, s = math.cos(angle), math.sin(angle)
    first, second = ((1, 2), (2, 0), (0, 1))[axis]
    matrix = np.eye(3)
    matrix[first, first] = matrix[second, second] = c
    matrix[first, second], matrix[second, first] = s, -s
    return matrix
