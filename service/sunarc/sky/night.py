"""Moon, planets and bright stars: apparent directions in the same air as the sun's, by ephem (libastro).

UT1 is taken as UTC, as for the sun: both turn by the same angle, 0.9 s or 13 arcseconds at most.

References: P. Bretagnon and G. Francou, VSOP87 (planets); M. Chapront-Touzé and J. Chapront, ELP 2000-85 (moon), as in
libastro. The stars' table: `stars.csv.gz`, its header names the sources.
"""

from __future__ import annotations

import gzip
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.resources import files
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from sunarc.common.array_types import BoolArray, FloatArray, IntArray, NameArray, picked
from sunarc.common.utc import DAY_S
from sunarc.sky.directions import angles_from_direction, direction_from_angles
from sunarc.sky.refraction import apparent_elevation
from sunarc.sky.site import Site

SolarSystemBody = Literal["moon", "venus", "mars", "jupiter", "saturn"]
SOLAR_SYSTEM_BODIES: tuple[SolarSystemBody, ...] = get_args(SolarSystemBody)
SUN = "sun"
STAR = "star:HIP"
"""How the name of a star begins; its Hipparcos number follows."""

FAINTEST_V = 5.5
"""Where the table of stars ends; fainter neighbours are not known."""
_EPOCH_YEAR = 2024.0
_J2000_UNIX_S = 946_728_000.0
_UNIX_S_OF_EPHEM = -2_209_032_000.0
"""ephem counts days from 1899-12-31 12:00 UTC."""
_SIDEREAL_DAY_S = 86_164.0905
_LAST_LEAP_SECOND_UNIX_S = 1_483_228_800.0
"""The start of 2017."""
_TT_MINUS_UTC_S = 69.184
"""Since then: 37 s of leap seconds and 32.184 s."""
_RAD_PER_MAS = math.radians(1.0 / 3.6e6)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StarTable:
    """Bright stars.

    Attributes
    ----------
    hip : (n,) Hipparcos numbers.
    right_ascension, declination : (n,) ICRS at the epoch 2024.0, radians.
    motion : (n, 2) proper motion, radians a year, that of the right ascension times the cosine of the declination.
    magnitude : (n,) V.
    """

    hip: IntArray
    right_ascension: FloatArray
    declination: FloatArray
    motion: FloatArray
    magnitude: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NightSky:
    """Stars and planets above the horizon at one time.

    Attributes
    ----------
    names : (n,) `star:HIP32349`, `venus`.
    directions : (n, 3) apparent ones, east-north-up.
    magnitude : (n,) V, outside the atmosphere.
    """

    names: NameArray
    directions: FloatArray
    magnitude: FloatArray

    def __len__(self) -> int:
        return int(self.magnitude.size)

    def find_rows(self, names: Sequence[str]) -> IntArray:
        """Return the rows (m,) of names that are all in it."""
        row = {name: index for index, name in enumerate(self.names.tolist())}
        return np.array([row[name] for name in names], dtype=np.int64)

    def select(self, which: BoolArray | IntArray) -> NightSky:
        """Return those that a mask or an index picks."""
        return picked(self, which)


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyPosition:
    """Position of the moon or a planet.

    Attributes
    ----------
    direction : apparent unit vector, east-north-up, of the disc's centre seen from the site.
    magnitude : V, outside the atmosphere.
    radius : of the disc, radians.
    illuminated_fraction : of the disc, 0 to 1.
    """

    direction: tuple[float, float, float]
    magnitude: float
    radius: float
    illuminated_fraction: float


def star_table() -> StarTable:
    """Return the 2848 stars to `FAINTEST_V`."""
    text = gzip.decompress(files("sunarc.sky").joinpath("stars.csv.gz").read_bytes()).decode("ascii")
    rows = [line.split(",") for line in text.splitlines() if line[0] not in "#h"]
    columns = np.array([[float(cell) for cell in row] for row in rows])
    return StarTable(
        hip=columns[:, 0].astype(np.int64),
        right_ascension=np.radians(columns[:, 1]),
        declination=np.radians(columns[:, 2]),
        motion=columns[:, 3:5] * _RAD_PER_MAS,
        magnitude=columns[:, 5],
    )


def star_directions(stars: StarTable, unix_s: float, site: Site) -> FloatArray:
    """Return the apparent directions of stars at one moment, (n, 3), east-north-up.

    With proper motion, precession, nutation, aberration and refraction, without parallax
    (0.75 arcseconds at most). Below the horizon the refraction fades to 0, as the sun's.
    """
    ephem = _import_ephem()
    observer = _make_observer(unix_s, site)
    years = 2000.0 + (unix_s - _J2000_UNIX_S) / DAY_S / 365.25 - _EPOCH_YEAR
    moved = stars.motion * years
    right = stars.right_ascension + moved[:, 0] / np.cos(stars.declination)
    angles = np.empty((right.size, 2))
    body = ephem.FixedBody()
    body._epoch = ephem.J2000  # noqa: SLF001 - ephem's own names for what a caller sets
    for row, (ra, dec) in enumerate(zip(right.tolist(), (stars.declination + moved[:, 1]).tolist(), strict=True)):
        body._ra, body._dec = ra, dec  # noqa: SLF001 - likewise
        body.compute(observer)
        angles[row] = body.alt, body.az
    return _refract_angles(angles[:, 0], angles[:, 1], site)


def body_position(name: SolarSystemBody, unix_s: float, site: Site) -> BodyPosition:
    """Return where the moon or a planet is at one moment, seen from the site (not from the Earth's centre)."""
    ephem = _import_ephem()
    body = getattr(ephem, name.capitalize())()
    body.compute(_make_observer(unix_s, site))
    direction = _refract_angles(np.array([float(body.alt)]), np.array([float(body.az)]), site)[0]
    east, north, up = direction.tolist()
    return BodyPosition(
        direction=(east, north, up),
        magnitude=float(body.mag),
        radius=float(body.radius),
        illuminated_fraction=float(body.phase) / 100.0,
    )


class TruePosition(NamedTuple):
    """A body without refraction: unit vector (3,) east-north-up, radius in radians, distance in au, V."""

    direction: FloatArray
    radius: float
    distance_au: float
    magnitude: float


def true_position(name: Literal["moon", "sun"], unix_s: float, site: Site) -> TruePosition:
    """Return where the moon or the sun is without refraction, seen from the site; the distance is the Earth's."""
    ephem = _import_ephem()
    body = getattr(ephem, name.capitalize())()
    body.compute(_make_observer(unix_s, site))
    direction = direction_from_angles(
        zenith_deg=90.0 - math.degrees(float(body.alt)), azimuth_deg=math.degrees(float(body.az))
    )
    return TruePosition(direction, float(body.radius), float(body.earth_distance), float(body.mag))


def night_sky(unix_s: float, site: Site, *, faintest: float) -> NightSky:
    """Return the stars and planets above the horizon at one moment, the brightest first, down to a magnitude.

    Parameters
    ----------
    unix_s : seconds since 1970-01-01 UTC.
    site : the place and its air.
    faintest : V of the faintest; the table ends at `FAINTEST_V`.
    """
    stars = picked(_cached_star_table(), _cached_star_table().magnitude <= faintest)
    planets = {name: body_position(name, unix_s, site) for name in SOLAR_SYSTEM_BODIES if name != "moon"}
    names = np.array([f"{STAR}{hip}" for hip in stars.hip] + list(planets))
    places = [place.direction for place in planets.values()]
    magnitude = np.concatenate([stars.magnitude, [place.magnitude for place in planets.values()]])
    sky = NightSky(
        names=names,
        directions=np.concatenate([star_directions(stars, unix_s, site), np.array(places)]),
        magnitude=magnitude,
    )
    order = np.argsort(magnitude, kind="stable")
    return sky.select(order[(sky.directions[order, 2] > 0.0) & (magnitude[order] <= faintest)])


def body_directions(
    names: NameArray,
    unix_s: FloatArray,
    site: Site,
    *,
    temperature: FloatArray | None = None,
    pressure: FloatArray | None = None,
) -> FloatArray:
    """Return the apparent directions (n, 3), east-north-up, of stars, planets and the moon at their moments.

    NaN for the sun, whose path is computed by `sun_directions`, and for a name that no body has.

    Parameters
    ----------
    names : (n,) as in `NightSky`.
    unix_s : (n,) seconds since 1970-01-01 UTC.
    site : the place and its air.
    temperature, pressure : (n,) of the air, °C and Pa, as measured; the site's where None or NaN.
    """
    directions = np.full((unix_s.size, 3), np.nan)
    row_by_name = {f"{STAR}{hip}": row for row, hip in enumerate(_cached_star_table().hip.tolist())}
    star = np.array([row_by_name.get(name, -1) for name in names.tolist()], dtype=np.int64)
    bodies = [(np.asarray(names == name), name) for name in SOLAR_SYSTEM_BODIES]
    # all of one moment at once: many stars are of one image
    for moment in np.unique(unix_s[(star >= 0) | np.isin(names, SOLAR_SYSTEM_BODIES)]).tolist():
        now = unix_s == moment
        air = site.replace_air(temperature=_first_measured(temperature, now), pressure=_first_measured(pressure, now))
        if np.any(stars := now & (star >= 0)):
            directions[stars] = star_directions(picked(_cached_star_table(), star[stars]), moment, air)
        for named, name in bodies:
            if np.any(here := now & named):
                directions[here] = body_position(name, moment, air).direction
    return directions


def _first_measured(column: FloatArray | None, now: BoolArray) -> float | None:
    """Return the first number of some rows; None where it is not measured."""
    value = math.nan if column is None else float(column[np.flatnonzero(now)[0]])
    return value if math.isfinite(value) else None


@cache
def _cached_star_table() -> StarTable:
    return star_table()


def _import_ephem() -> Any:  # noqa: ANN401 - a module
    return import_module("ephem")  # loaded when it is used


def _make_observer(unix_s: float, site: Site) -> Any:  # noqa: ANN401 - ephem is not typed
    ephem = _import_ephem()
    date = (unix_s - _UNIX_S_OF_EPHEM) / DAY_S
    # ephem's terrestrial time is an old forecast, 5 s ahead in 2026 and 37 s in 2050, in which the moon moves by 20
    # arcseconds: the moment is shifted by as much, and the place turned back, so that the sidereal time stays
    late_s = _TT_MINUS_UTC_S - ephem.delta_t(date) if unix_s > _LAST_LEAP_SECOND_UNIX_S else 0.0
    observer = ephem.Observer()
    observer.lat = math.radians(site.latitude)
    observer.lon = math.radians(site.longitude) - 2.0 * math.pi * late_s / _SIDEREAL_DAY_S
    observer.elevation = site.altitude
    observer.pressure = 0.0  # the refraction is the sun's own
    observer.date = date + late_s / DAY_S
    return observer


def _refract_angles(elevation: FloatArray, azimuth: FloatArray, site: Site) -> FloatArray:
    """Return apparent directions (n, 3) of true elevations and azimuths, radians."""
    raised = apparent_elevation(np.degrees(elevation), site)
    return direction_from_angles(zenith_deg=90.0 - raised, azimuth_deg=np.degrees(azimuth))


MOON_RADIUS_KM = 1737.4
"""Mean radius; IAU Working Group on Cartographic Coordinates and Rotational Elements (2015)."""
_AU_KM = 149_597_870.7


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MoonDisc:
    """The moon at one moment.

    Attributes
    ----------
    direction : (3,) apparent unit vector, east-north-up, of the disc's centre.
    edges : (3, 2) from there to the middle of the lit limb, and to the limb a quarter of the circle onwards, radians;
        the refraction of the horizon flattens them.
    cos_phase : cosine of the phase angle (sun, moon, site): 1 is full, 0 half, -1 new.
    magnitude : V, outside the atmosphere.
    """

    direction: FloatArray
    edges: FloatArray
    cos_phase: float
    magnitude: float

    @property
    def illuminated_fraction(self) -> float:
        """Of the disc, 0 to 1."""
        return 0.5 * (1.0 + self.cos_phase)


def moon_disc(unix_s: float, site: Site) -> MoonDisc:
    """Return the moon's disc at one moment, seen from the site."""
    moon, sun = true_position("moon", unix_s, site), true_position("sun", unix_s, site)
    distance_km = MOON_RADIUS_KM / np.sin(moon.radius)
    to_sun = sun.direction * sun.distance_au * _AU_KM - moon.direction * distance_km
    to_sun /= np.linalg.norm(to_sun)
    along = to_sun - (to_sun @ moon.direction) * moon.direction
    along /= max(float(np.linalg.norm(along)), 1e-12)
    tangents = np.stack([along, np.cross(moon.direction, along)])
    limbs = [_refract_directions(moon.direction + side * moon.radius * tangents, site) for side in (1.0, -1.0)]
    return MoonDisc(
        direction=_refract_directions(moon.direction[None], site)[0],
        edges=np.asarray(0.5 * (limbs[0] - limbs[1]).T),
        cos_phase=float(np.clip(-to_sun @ moon.direction, -1.0, 1.0)),
        magnitude=moon.magnitude,
    )


def _refract_directions(directions: FloatArray, site: Site) -> FloatArray:
    """Return the apparent directions (n, 3) of true ones."""
    zenith, azimuth = angles_from_direction(directions / np.linalg.norm(directions, axis=-1, keepdims=True))
    return direction_from_angles(zenith_deg=90.0 - apparent_elevation(90.0 - zenith, site), azimuth_deg=azimuth)


# fmt: off
_NAMES = {
    677: "Alpheratz", 746: "Caph", 1067: "Algenib", 2081: "Ankaa", 3179: "Schedar", 3419: "Diphda", 5447: "Mirach",
    7588: "Achernar", 9640: "Almach", 9884: "Hamal", 11767: "Polaris", 13847: "Acamar", 14135: "Menkar", 14576:
    "Algol", 15863: "Mirfak", 17499: "Electra", 17531: "Taygeta", 17573: "Maia", 17608: "Merope", 17702: "Alcyone",
    17847: "Atlas", 18543: "Zaurak", 21421: "Aldebaran", 24436: "Rigel", 24608: "Capella", 25336: "Bellatrix",
    25428: "Elnath", 25606: "Nihal", 25930: "Mintaka", 25985: "Arneb", 26311: "Alnilam", 26727: "Alnitak", 27366:
    "Saiph", 27989: "Betelgeuse", 28360: "Menkalinan", 30324: "Mirzam", 30438: "Canopus", 31681: "Alhena", 32349:
    "Sirius", 33579: "Adhara", 34444: "Wezen", 36850: "Castor", 37279: "Procyon", 37826: "Pollux", 39429: "Naos",
    41037: "Avior", 44816: "Suhail", 45238: "Miaplacidus", 46390: "Alphard", 49669: "Regulus", 50583: "Algieba",
    53910: "Merak", 54061: "Dubhe", 57632: "Denebola", 58001: "Phecda", 59316: "Minkar", 59774: "Megrez", 59803:
    "Gienah", 60718: "Acrux", 61084: "Gacrux", 62434: "Mimosa", 62956: "Alioth", 63608: "Vindemiatrix", 65378:
    "Mizar", 65474: "Spica", 65477: "Alcor", 67301: "Alkaid", 68702: "Hadar", 68756: "Thuban", 68933: "Menkent",
    69673: "Arcturus", 71683: "Rigil Kentaurus", 72105: "Izar", 72607: "Kochab", 72622: "Zubenelgenubi", 76267:
    "Alphecca", 77070: "Unukalhai", 80763: "Antares", 82273: "Atria", 84012: "Sabik", 84345: "Rasalgethi", 85927:
    "Shaula", 86032: "Rasalhague", 86742: "Cebalrai", 87833: "Eltanin", 90185: "Kaus Australis", 91262: "Vega",
    92420: "Sheliak", 92855: "Nunki", 93194: "Sulafat", 95241: "Arkab Prior", 95294: "Arkab Posterior", 95347:
    "Rukbat", 95947: "Albireo", 97278: "Tarazed", 97649: "Altair", 98036: "Alshain", 100453: "Sadr", 100751:
    "Peacock", 102098: "Deneb", 105199: "Alderamin", 106032: "Alfirk", 107315: "Enif", 109074: "Sadalmelik", 109268:
    "Alnair", 113368: "Fomalhaut", 113881: "Scheat", 113963: "Markab",
}
"""Names of the working group on star names of the IAU, of the stars that ephem lists, matched within 40 arcseconds."""
# fmt: on


def common_name(body: str) -> str:
    """Return the common name of a body: Sirius, HIP 12345, Venus."""
    if not body.startswith(STAR):
        return body.capitalize()
    number = int(body.removeprefix(STAR))
    return _NAMES.get(number, f"HIP {number}")
