"""Values of the housekeeping: disk space and the camera's temperature over an hour or a day."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Literal, TypeVar

from sunarc.json_fields import Returned, Time, described

HousekeepingStep = Literal["hour", "day"]
_Number = TypeVar("_Number", int, float)


@dataclass(frozen=True, slots=True, kw_only=True)
class Housekeeping(Returned):
    """What was measured in an hour or in a UTC day."""

    time: Annotated[Time, described("Beginning of the hour or of the UTC day.", "2013-05-13T18:00:00Z")]
    disk_free_bytes: Annotated[
        int | None, described("Least free space where the images are, bytes; null where not measured.", 82_000_000_000)
    ] = None
    images_bytes: Annotated[
        int | None, described("Largest size of the stored images, bytes; null where not measured.", 12_000_000_000)
    ] = None
    temperature_c: Annotated[
        float | None, described("Mean of the camera's temperatures, degrees Celsius; null without any.", 41.5)
    ] = None
    temperature_min_c: Annotated[float | None, described("The lowest of them, degrees Celsius.", 40.0)] = None
    temperature_max_c: Annotated[float | None, described("The highest of them, degrees Celsius.", 43.0)] = None
    n_temperatures: Annotated[int, described("How many temperatures were read, a count.", 360)] = 0


def merged(one: Housekeeping, other: Housekeeping, *, time: datetime) -> Housekeeping:
    """Return what was measured in both of two spans.

    Parameters
    ----------
    one, other : in any order.
    time : beginning of the span that has both.
    """
    n = one.n_temperatures + other.n_temperatures
    weighted = [part.temperature_c * part.n_temperatures for part in (one, other) if part.temperature_c is not None]
    return Housekeeping(
        time=time,
        disk_free_bytes=_of(min, one.disk_free_bytes, other.disk_free_bytes),
        images_bytes=_of(max, one.images_bytes, other.images_bytes),
        temperature_c=sum(weighted) / n if n else None,
        temperature_min_c=_of(min, one.temperature_min_c, other.temperature_min_c),
        temperature_max_c=_of(max, one.temperature_max_c, other.temperature_max_c),
        n_temperatures=n,
    )


def _of(select: Callable[[list[_Number]], _Number], *values: _Number | None) -> _Number | None:
    known = [value for value in values if value is not None]
    return select(known) if known else None
