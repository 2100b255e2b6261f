"""What a camera's neighbours show of it, as a hub keeps it: values, and their JSON in the night's results."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from datetime import date
from typing import Annotated, Any, Literal

from pydantic import TypeAdapter, ValidationError

from sunarc.cross_checks.causes import Cause
from sunarc.json_fields import EXAMPLE_TIME, Returned, Time, described

Found = Cause | Literal["clock_by_clouds"]
NO_ALARMS: frozenset[Found] = frozenset({"slow_turn"})
"""What is found and is nothing that somebody has to correct."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossCheck(Returned):
    """What a camera's neighbours show of it."""

    camera: Annotated[str, described("Its name.", "roof")]
    neighbours: Annotated[tuple[str, ...], described("Cameras it was compared with.", ["mast", "gate"])]
    n_days: Annotated[int, described("Days that showed how it stood turned, a count.", 34)]
    found: Annotated[
        tuple[Found, ...],
        described(
            "What is wrong or changed; empty: nothing. `clock_by_clouds`: edges of clouds come early or late. "
            "`slow_turn` alone is no alarm."
        ),
    ]
    since: Annotated[date | None, described("First solar date after a step of its rotation.", "2026-06-26")] = None
    clock_s: Annotated[float | None, described("The step, as a clock that is ahead, s; the same as:", 2.1)] = None
    clock_sigma_s: Annotated[float | None, described("Its 1-sigma, s.", 0.2)] = None
    longitude_deg: Annotated[float | None, described("as a longitude stated too far east.", 0.0088)] = None
    longitude_sigma_deg: Annotated[float | None, described("Its 1-sigma, degrees.", 0.0008)] = None
    north_deg: Annotated[float | None, described("The step about the vertical, counter-clockwise.", 0.1)] = None
    north_sigma_deg: Annotated[float | None, described("Its 1-sigma, degrees.", 0.001)] = None
    rotation_deg: Annotated[tuple[float, ...] | None, described("About east, north and up.", [0.0, 0.0, 0.1])] = None
    rotation_sigma_deg: Annotated[tuple[float, ...] | None, described("1-sigma of each.", [0.001] * 3)] = None
    cloud_clock_s: Annotated[
        float | None,
        described("By how much its clock is ahead if its neighbours' are right, by edges of clouds, s.", 1.5),
    ] = None
    cloud_clock_sigma_s: Annotated[float | None, described("Its 1-sigma, mostly of the wind, s.", 12.0)] = None

    @property
    def alarms(self) -> tuple[Found, ...]:
        """What of it somebody has to correct."""
        return tuple(one for one in self.found if one not in NO_ALARMS)

    def as_json(self) -> dict[str, Any]:
        """Return the fields by name, as JSON has them."""
        return asdict(self) | {"since": None if self.since is None else self.since.isoformat()}


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossChecks(Returned):
    """The newest cross-checks of a fleet."""

    night: Annotated[date | None, described("Solar date of the night that made them; null: none did.", "2026-06-30")]
    time: Annotated[Time | None, described("When that night's work began.", EXAMPLE_TIME)]
    checks: Annotated[tuple[CrossCheck, ...], described("Cameras with alarms first, then those that turn slowly.")]


_CHECK: TypeAdapter[CrossCheck] = TypeAdapter(CrossCheck)


def checks_from_json(stored: object) -> tuple[CrossCheck, ...] | None:
    """Return the checks that a night stored, alarms first; None where it stored none.

    A check that cannot be read, as one of a newer hub with another word, is left out.
    """
    rows = stored.get("checks") if isinstance(stored, Mapping) else None
    if not isinstance(rows, list):
        return None
    return tuple(sorted(_read(rows), key=lambda one: (not one.alarms, not one.found, one.camera)))


def _read(rows: Iterable[object]) -> Iterable[CrossCheck]:
    for row in rows:
        try:
            yield _CHECK.validate_python(row)
        except ValidationError:
            continue
