"""States of a hub's cameras: the worst one of each, and every reason for it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from datetime import date, datetime, timedelta
from functools import lru_cache
from typing import Annotated, Any, Literal, get_args

import numpy as np

from sunarc.common.utc import DAY_S
from sunarc.hub.nightly_store import CrossCheck, CrossChecks
from sunarc.imager.archive.feed_rows import FleetCamera
from sunarc.imager.runtime.json_fields import Returned, described
from sunarc.imager.runtime.states import State as ServiceState
from sunarc.imager.runtime.states import state_and_text, worst
from sunarc.imager.runtime.status import Reason
from sunarc.sky.days import solar_date
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

SILENT = timedelta(minutes=15)
"""A camera that sent nothing for so long is silent: imagers report their state every minute."""
LARGEST_SIGMA_DEG = 0.25
"""Of a calibration that is certain enough, over the sky (RMS): the radius of the sun."""
LARGEST_DRIFT_DEG = 0.25
"""Of a camera against its calibration."""
LEAST_DISK_BYTES = 100e6
"""Of a disk that is not full: imagers remove images when 1200 MB are left."""
_CROSSED = timedelta(days=3)
"""A result of neighbours from an earlier night is no reason any more."""
NO_CHECKS = CrossChecks(night=None, time=None, checks=())
_SUN_UP = math.sin(math.radians(10.0))
"""From this elevation on a camera is to have observed the sun, seen or not."""
_SOONEST_S = 2 * 3600.0
"""Sightings may be under way for so long."""
_HOUR_S = 3600.0
_LONGEST_NIGHT_DAYS = 200

State = Literal["silent", "not_ready", "degraded", "quarantine", "uncalibrated", "ready"]
"""How a camera is, the worst first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetReason(Returned):
    """A reason why a camera is not ready."""

    code: Annotated[str, described("The imager's own condition (docs/codes.md), or what the hub found.", "drift")]
    text: Annotated[str, described("The same in words, with value and limit.", "drift 3.02°, more than 0.25°")]


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetMember(FleetCamera):
    """A camera in the hub's view, with its worst state."""

    state: Annotated[State, described("The worst of it; `quarantine`: something of it was refused or set apart.")]
    service_state: Annotated[
        ServiceState, described("The same in the words of the imager's own `/readyz`, with what the hub finds.")
    ]
    state_text: Annotated[
        str, described("What decides `service_state`, in a sentence.", "moved by 2.50° ± 0.30° on 27 Nov 14:05 UTC")
    ]
    why: Annotated[tuple[FleetReason, ...], described("Why it is not ready, the worst first; empty: it is.")] = ()


def members(cameras: tuple[FleetCamera, ...], now: datetime, crossed: CrossChecks = NO_CHECKS) -> list[FleetMember]:
    """Return cameras with their states, the worst first; of one state, the most uncertain first.

    Parameters
    ----------
    cameras, now : what the hub knows of them, and real time.
    crossed : what neighbours showed in the last night.
    """
    names = [one.name for one in fields(FleetCamera)]
    is_new = crossed.time is not None and now - crossed.time <= _CROSSED
    checks = {one.camera: one for one in crossed.checks} if is_new else {}
    found = []
    for camera in cameras:
        check = checks.get(camera.camera)
        of_state = [*_list_reasons(camera, now), *(_list_cross_check_causes(check) if check is not None else ())]
        order = sorted(of_state, key=lambda one: get_args(State).index(one[0]))
        state: State = order[0][0] if order else "ready"
        values = {name: getattr(camera, name) for name in names}
        service_state, text = _choose_service_state(camera, order)
        why = tuple(reason for _, reason in order)
        found.append(FleetMember(**values, state=state, service_state=service_state, state_text=text, why=why))
    of_fleet, of_service = get_args(State).index, get_args(ServiceState).index
    return sorted(
        found,
        key=lambda one: (
            of_service(one.service_state),
            of_fleet(one.state),
            -(one.sky_rms_deg or 0.0),
            one.camera,
        ),
    )


def _choose_service_state(camera: FleetCamera, found: list[tuple[State, FleetReason]]) -> tuple[ServiceState, str]:
    """Return the state of a camera, as its imager reports it or by its conditions, with the hub's own findings."""
    status: Mapping[str, Any] = camera.status or {}
    own, listed = status.get("state"), status.get("conditions")
    reported_state = next((word for word in get_args(ServiceState) if word == own), None)
    reported = set(map(str, listed)) if reported_state is not None and isinstance(listed, list) else set()
    state, text = state_and_text(
        Reason(
            code=reason.code,
            severity="not_ready" if kind == "not_ready" else "degraded",
            text=reason.text,
            remedy="",
        )
        for kind, reason in found
        if reason.code not in reported
    )
    if reported_state is not None and worst((reported_state, state)) == reported_state:
        return reported_state, str(status.get("state_text") or own)
    return state, text


def status_number(camera: FleetCamera, name: str) -> float | None:
    """Return a number that a camera reported of itself; None where it reported none."""
    value = (camera.status or {}).get(name)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _list_reasons(camera: FleetCamera, now: datetime) -> Iterator[tuple[State, FleetReason]]:
    """Yield every reason why a camera is not ready, with the state that it makes."""
    received_at = camera.received_at
    if received_at is None:
        yield "silent", FleetReason(code="silent", text="has never sent anything")
    elif now - received_at > SILENT:
        yield "silent", FleetReason(code="silent", text=f"nothing for {_format_span(now - received_at)}")
    if camera.status is None and camera.status_at is not None:
        text = "its last report of itself cannot be shown: too large, too deep, or no text"
        yield "degraded", FleetReason(code="status_unreadable", text=text)
    yield from _list_reported(camera)
    if received_at is not None:
        yield from _list_found(camera, now)
    if camera.n_quarantined:
        yield "quarantine", FleetReason(code="quarantine", text=f"{camera.n_quarantined} in quarantine")
    if received_at is not None and camera.calibration is None:
        yield "uncalibrated", FleetReason(code="uncalibrated", text="no calibration")


def _list_reported(camera: FleetCamera) -> Iterator[tuple[State, FleetReason]]:
    """Yield the reasons that an imager reports of itself."""
    status: Any = camera.status or {}
    health, listed = status.get("health"), status.get("conditions")
    codes = [str(code) for code in listed] if isinstance(listed, list) else []
    if health in {"not_ready", "degraded"}:
        for code in codes or [health]:
            yield health, FleetReason(code=code, text=code.replace("_", " "))


def _list_found(camera: FleetCamera, now: datetime) -> Iterator[tuple[State, FleetReason]]:
    """Yield the reasons that the hub finds in a camera's rows."""
    drift, free = status_number(camera, "drift_deg"), status_number(camera, "disk_free_bytes")
    sigma = camera.sky_rms_deg
    if drift is not None and drift > LARGEST_DRIFT_DEG:
        yield "degraded", FleetReason(code="drift", text=f"drift {drift:.2f}°, more than {LARGEST_DRIFT_DEG:g}°")
    if free is not None and free < LEAST_DISK_BYTES:
        text = f"disk full: {free / 1e6:.0f} MB free, less than {LEAST_DISK_BYTES / 1e6:.0f} MB"
        yield "degraded", FleetReason(code="disk", text=text)
    if camera.calibration is not None and (sigma is None or sigma > LARGEST_SIGMA_DEG):
        stated = "not stated" if sigma is None else f"{sigma:.2f}°, more than {LARGEST_SIGMA_DEG:g}°"
        yield "degraded", FleetReason(code="calibration_uncertain", text=f"1-sigma {stated}")
    is_new = camera.last_sighting_at is None and camera.calibration is None
    if camera.latitude is None or camera.longitude is None or is_new:
        return
    hour = math.floor(now.timestamp() / _HOUR_S)
    since = _last_day_with_sun(camera.latitude, camera.longitude, hour)
    newest = camera.last_sighting_at
    if since is not None and (newest is None or _solar_date(newest, camera.longitude) < since):
        seen = "none" if newest is None else f"{newest:%Y-%m-%d}"
        text = f"newest sighting {seen}, the sun was up on {since.isoformat()}"
        yield "degraded", FleetReason(code="no_sighting", text=text)


def _list_cross_check_causes(check: CrossCheck) -> Iterator[tuple[State, FleetReason]]:
    """Yield the causes that neighbours show of a camera, with size and probability."""
    for cause in check.alarms:
        if cause == "clock_by_clouds":
            ahead = _format_measurement(check.cloud_clock_s, check.cloud_clock_sigma_s, " s")
            text = f"clock {ahead} ahead by edges of clouds"
        else:
            clock = _format_measurement(check.clock_s, check.clock_sigma_s, " s")
            longitude = _format_measurement(check.longitude_deg, check.longitude_sigma_deg, "°")
            size = {
                "clock": f"clock {clock} ahead",
                "longitude": f"longitude stated {longitude} too far east",
                "north": f"north turned by {_format_measurement(check.north_deg, check.north_sigma_deg, '°')}",
            }.get(cause, f"{cause.replace('_', ' ')} by {math.hypot(*(check.rotation_deg or ())):.3g}°")
            sure = "" if check.confidence is None else f", probability {check.confidence:.2f}"
            text = f"{size} since {check.since}: by {check.agreeing} neighbours{sure}"
        yield "degraded", FleetReason(code=f"neighbours_{cause}", text=text)


def _format_measurement(size: float | None, sigma: float | None, unit: str) -> str:
    return "" if size is None or sigma is None else f"{size:.3g} ± {sigma:.2g}{unit}"


def _solar_date(time: datetime, longitude: float) -> date:
    return solar_date(time.timestamp(), longitude=longitude)


@lru_cache(maxsize=8192)
def _last_day_with_sun(latitude: float, longitude: float, hour: int) -> date | None:
    """Return the last solar date with the sun above 10° until 2 h before an hour; None in a polar night.

    Parameters
    ----------
    latitude, longitude : of the camera, degrees.
    hour : since 1970.
    """
    site = Site(latitude=latitude, longitude=longitude)
    until_s = hour * _HOUR_S - _SOONEST_S
    hours = until_s - _HOUR_S * np.arange(48.0)
    noon_s = until_s - (until_s + longitude * 240.0 - 43_200.0) % DAY_S
    for times in (hours, noon_s - DAY_S * np.arange(float(_LONGEST_NIGHT_DAYS))):
        up = np.flatnonzero(sun_directions(times, site)[:, 2] > _SUN_UP)
        if up.size:
            return solar_date(float(times[up[0]]), longitude=longitude)
    return None


def _format_span(span: timedelta) -> str:
    hours = span.total_seconds() / 3600.0
    if hours < 2.0:
        return f"{60.0 * hours:.0f} min"
    return f"{hours:.0f} h" if hours < 48.0 else f"{hours / 24.0:.0f} days"
