"""Values of a notebook: a site, sightings, and the answers of a calibration."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from sunarc.calibration.model.sightings import Sightings as Points
from sunarc.common.array_types import FloatArray, stacked
from sunarc.common.bounds import require_bounds
from sunarc.common.errors import InputError
from sunarc.formats.csv_files import RowPlaces, name_bodies, read_unplaced
from sunarc.public.inputs import Times, Values, asked_times, number, numbers, texts, unix_seconds
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.night import SUN
from sunarc.sky.site import Altitude, Latitude, Longitude, PressurePa, TemperatureC
from sunarc.sky.site import Site as Place
from sunarc.sky.sun import sun_angles
from sunarc.sources.files import read_lines

StrPath = str | os.PathLike[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Site:
    """A place on the ground, and the air there.

    Examples
    --------
    >>> import sunarc
    >>> sunarc.Site(latitude=36.604, longitude=-97.485, altitude_m=318)
    Site(latitude=36.604, longitude=-97.485, altitude_m=318.0, pressure_pa=None, temperature_c=12.0)
    """

    latitude: Latitude
    """Degrees, north positive."""
    longitude: Longitude
    """Degrees, east positive."""
    altitude_m: Altitude = 0.0
    """Metres above sea level."""
    pressure_pa: PressurePa | None = None
    """Annual mean air pressure; from the altitude unless given."""
    temperature_c: TemperatureC = 12.0
    """Annual mean air temperature, degrees Celsius."""

    def __post_init__(self) -> None:
        """Refuse an invalid place."""
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, number(value, field=f"site.{name}"))
        require_bounds(self, section_path="site")

    @property
    def place(self) -> Place:
        """The site as the library has it; internal."""
        return Place(
            latitude=self.latitude,
            longitude=self.longitude,
            altitude=self.altitude_m,
            pressure=self.pressure_pa,
            temperature=self.temperature_c,
        )


def notebook_site(place: Place) -> Site:
    """Return the site of a calibration as a notebook has it."""
    return Site(
        latitude=place.latitude,
        longitude=place.longitude,
        altitude_m=place.altitude,
        pressure_pa=place.pressure,
        temperature_c=place.temperature,
    )


def require_site(site: object) -> Site:
    """Return a site; InputError where it is something else."""
    if not isinstance(site, Site):
        remedy = "give sunarc.Site(latitude=..., longitude=..., altitude_m=...)"
        raise InputError(field="site", problem=f"{site!r} is no site", remedy=remedy)
    return site


def require_sightings(sightings: object) -> Sightings:
    """Return sightings; InputError where they are something else."""
    if not isinstance(sightings, Sightings):
        remedy = "give sunarc.Sightings(time=..., x_px=..., y_px=...), or sunarc.read_sightings(FILE)"
        raise InputError(field="sightings", problem=f"{type(sightings).__name__} is no sightings", remedy=remedy)
    return sightings


class WithSightings(Protocol):
    """The result of a search in a picture."""

    def sightings(self) -> Sightings:
        """Return the accepted sightings."""


@dataclass(frozen=True, slots=True, init=False, eq=False, repr=False)
class Sightings:
    """Pixels at which the sun was seen, or another body, with their times.

    Parameters
    ----------
    time : (n,) mid-exposure: numpy datetime64 (UTC), pandas or `datetime` with a time zone, ISO 8601 text with one.
    x_px, y_px : (n,) the body's centre; (0, 0) is the centre of the top-left pixel, x right, y down.
    sigma_px : (n,) or one: stated 1-sigma per axis; their ratios count.
    body : (n,) or one name: `sun`, `moon`, a planet, `star:HIP32349`; the sun unless given.
    zenith_deg, azimuth_deg : (n,) apparent angles of what has no such name.

    Raises
    ------
    InputError
        Where a time has no zone, a number is not finite, or the columns differ in length.

    Examples
    --------
    >>> import sunarc
    >>> times = ["2013-05-13T18:30:00Z", "2013-05-13T12:40:00-06:00"]
    >>> sunarc.Sightings(time=times, x_px=[812.1, 809.9], y_px=[640.3, 641.0])
    <sunarc.Sightings: 2 of 2013-05-13 18:30:00 to 2013-05-13 18:40:00 UTC>
    """

    points: Points
    """The sightings as the library has them; internal."""
    name: str
    """Name of the file that they are from."""
    wheres: RowPlaces
    """Where each row stands; internal."""

    def __init__(
        self,
        *,
        time: Times,
        x_px: Values,
        y_px: Values,
        sigma_px: Values | None = None,
        body: Any = SUN,  # noqa: ANN401 - a name, or names in any container
        zenith_deg: Values | None = None,
        azimuth_deg: Values | None = None,
    ) -> None:
        unix_s = unix_seconds(time)
        columns = {"x_px": numbers(x_px, field="x_px"), "y_px": numbers(y_px, field="y_px")}
        more = {"sigma_px": sigma_px, "zenith_deg": zenith_deg, "azimuth_deg": azimuth_deg}
        columns |= {key: numbers(value, field=key) for key, value in more.items() if value is not None}
        if (zenith_deg is None) != (azimuth_deg is None):
            raise InputError(
                field="zenith_deg, azimuth_deg", problem="one is given without the other", remedy="give both"
            )
        if np.any(columns.get("sigma_px", np.ones(1)) <= 0.0):
            raise InputError(field="sigma_px", problem="is not positive", remedy="give the 1-sigma per axis in px")
        for key, column in columns.items():
            if column.shape not in {unix_s.shape, ()} or (key in {"x_px", "y_px"} and column.shape != unix_s.shape):
                problem = f"has shape {column.shape}, time has {unix_s.shape}"
                raise InputError(field=key, problem=problem, remedy="give one number for each time")
        size = unix_s.size
        flat = {key: np.broadcast_to(column.ravel(), size) for key, column in columns.items()}
        bodies = texts(body, field="body")
        if bodies.shape not in {unix_s.shape, ()}:
            problem = f"has shape {bodies.shape}, time has {unix_s.shape}"
            raise InputError(field="body", problem=problem, remedy="give one name, or one for each time")
        stated: dict[str, FloatArray] = {}
        if zenith_deg is not None:
            angles = {key: flat[key] for key in ("zenith_deg", "azimuth_deg")}
            stated["directions"] = direction_from_angles(**angles)
        if sigma_px is not None:
            stated["sigma_px"] = flat["sigma_px"]
        points = Points.of(
            unix_s=unix_s.ravel(),
            pixels=np.stack([flat["x_px"], flat["y_px"]], axis=-1),
            body=np.array(np.broadcast_to(bodies.ravel(), size)),
            **stated,
        )
        self._set_fields(points, "sightings", RowPlaces("sightings, row", np.arange(size)))

    def _set_fields(self, points: Points, name: str, wheres: RowPlaces) -> None:
        for key, value in (("points", points), ("name", name), ("wheres", wheres)):
            object.__setattr__(self, key, value)

    @classmethod
    def from_points(cls, points: Points, name: str, wheres: RowPlaces) -> Sightings:
        """Return sightings that the library has; internal."""
        made = cls.__new__(cls)
        made._set_fields(points, name, wheres)  # noqa: SLF001 - its own
        return made

    @classmethod
    def from_found(cls, found: Iterable[WithSightings]) -> Sightings:
        """Return the accepted sightings of pictures, as `find_sun` and `find_stars` return them.

        Examples
        --------
        >>> import sunarc
        >>> sun = sunarc.find_sun("pictures/20130513T181400Z.jpg", time="2013-05-13T18:14:00Z")
        >>> len(sunarc.Sightings.from_found([sun]))
        1
        """
        parts = [one.sightings().points for one in found]
        points = stacked(parts) if parts else Points.of(unix_s=[], pixels=[])
        return cls.from_points(points, "sightings", RowPlaces("sightings, row", np.arange(len(points))))

    def at(self, site: Site) -> Points:
        """Return the sightings with the directions of the bodies at a site; internal."""
        return name_bodies(self.points, site.place, wheres=self.wheres)

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        if not len(self):
            return "<sunarc.Sightings: none>"
        first, last = (str(np.datetime64(round(t), "s")).replace("T", " ") for t in _first_and_last(self.points.unix_s))
        return f"<sunarc.Sightings: {len(self)} of {first} to {last} UTC>"

    @property
    def time(self) -> np.ndarray[Any, np.dtype[np.datetime64]]:
        """(n,) times, datetime64 in UTC."""
        return (self.points.unix_s * 1e6).round().astype("datetime64[us]")

    @property
    def x_px(self) -> FloatArray:
        """(n,) columns."""
        return self.points.pixels[:, 0]

    @property
    def y_px(self) -> FloatArray:
        """(n,) rows."""
        return self.points.pixels[:, 1]


def _first_and_last(unix_s: FloatArray) -> tuple[float, float]:
    return float(np.min(unix_s)), float(np.max(unix_s))


def read_sightings(path: StrPath) -> Sightings:
    """Return the sightings of a CSV file, as `sunarc calibrate` reads it.

    Parameters
    ----------
    path : columns `time_utc,x_px,y_px`, and any of `sigma_px`, `body`, `zenith_deg,azimuth_deg`, `temperature_c`,
        `pressure_hpa`, `clock_error_s`; times are ISO 8601 with Z.

    Raises
    ------
    InputError
        Naming the line and the column that are wrong.

    Examples
    --------
    >>> import sunarc
    >>> sightings = sunarc.read_sightings("sun.csv")
    >>> len(sightings)
    455
    """
    path = Path(path)
    points, wheres = read_unplaced(read_lines(path), name=path.name)
    return Sightings.from_points(points, path.stem, wheres)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Directions:
    """Directions of pixels, in the shape of the question; NaN where no direction lands on the pixel."""

    zenith_deg: Values
    """Apparent zenith angle, degrees."""
    azimuth_deg: Values
    """Degrees clockwise from north."""
    enu: Values
    """(..., 3) unit vectors, east-north-up."""
    sigma_deg: Values
    """1-sigma per axis on the sphere, degrees; NaN of a camera that states no uncertainty."""
    inside: Values
    """Whether the pixel lies within the image and the camera's field."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelPositions:
    """Pixels of directions, in the shape of the question; NaN beyond the camera's field."""

    x_px: Values
    """Column; (0, 0) is the centre of the top-left pixel."""
    y_px: Values
    """Row, downward."""
    sigma_px: Values
    """1-sigma per axis; NaN of a camera that states no uncertainty."""
    covariance_px2: Values
    """(..., 2, 2) of x and y."""
    inside: Values
    """Whether the pixel lies within the image and the camera's field."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CloudPositions:
    """Positions of clouds or of their shadows, in the shape of the question; NaN elsewhere."""

    east_m: Values
    """East of the camera."""
    north_m: Values
    """North of the camera."""
    up_m: Values
    """Above the camera's horizontal plane."""
    latitude: Values
    """Degrees, WGS 84."""
    longitude: Values
    """Degrees, WGS 84."""
    altitude_m: Values
    """On the scale of the site's altitude."""
    sigma_m: Values
    """1-sigma per axis on the ground, of the calibration and the height."""
    covariance_m2: Values
    """(..., 2, 2) of east and north."""
    shadow: CloudPositions | None = None
    """The shadows, where a time was given."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SunPosition:
    """The sun's position, in the shape of the times."""

    zenith_deg: Values
    """Apparent zenith angle, with refraction, as all zenith angles of sunarc are."""
    true_zenith_deg: Values
    """Without refraction."""
    azimuth_deg: Values
    """Degrees clockwise from north."""
    enu: Values
    """(..., 3) apparent unit vectors, east-north-up."""


def sun_position(time: Times, site: Site) -> SunPosition:
    """Return the sun's position as seen from a site (NREL's algorithm, as pvlib computes it).

    Parameters
    ----------
    time : numpy datetime64 (UTC), pandas or `datetime` with a time zone, ISO 8601 text with one; of any shape.
    site : the place and its air.

    Raises
    ------
    InputError
        Where a time has no zone.

    Examples
    --------
    >>> import sunarc
    >>> site = sunarc.Site(latitude=36.604, longitude=-97.485, altitude_m=318)
    >>> sun = sunarc.sun_position("2013-05-13T18:30:00Z", site)
    >>> print(f"{sun.zenith_deg:.2f} {sun.azimuth_deg:.2f}")
    18.06 182.86
    """
    times = asked_times(time)
    angles = sun_angles(times.rows[:, 0], require_site(site).place)
    directions = direction_from_angles(zenith_deg=angles.apparent_zenith, azimuth_deg=angles.azimuth)
    return SunPosition(
        zenith_deg=times.answer(angles.apparent_zenith),
        true_zenith_deg=times.answer(angles.zenith),
        azimuth_deg=times.answer(angles.azimuth),
        enu=times.answer(directions, "component"),
    )
