"""Checks of everything that the service needs, each with the remedy where it fails."""

from __future__ import annotations

import json
import shutil
import sys
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from datetime import timedelta
from importlib.metadata import version
from typing import Any

import sunarc
from sunarc.app import camera_opener, require_stored_site
from sunarc.archive import check, head_revision, newest_sound_copy, open_archive
from sunarc.diagnostics.camera_checks import CheckResult, Outcome, survey
from sunarc.errors import SunarcError
from sunarc.runtime.clock import Clock, host_clock_state
from sunarc.runtime.preflight import listen, prepare_state
from sunarc.settings import Settings
from sunarc.utc import utc_time

_LEAST_FREE_BYTES = 2_000_000_000
_LARGEST_CLOCK_ERROR_S = 1.0
_OLDEST_BACKUP = timedelta(days=3)
_ANSWER_S = 2.0


def run_checks(settings: Settings, *, clock: Clock) -> Iterator[CheckResult]:
    """Run all checks; the results are what `sunarc check` prints."""
    running = _running(settings)
    yield CheckResult("settings", "ok", f"camera {settings.name!r}, state in {settings.state}")
    yield _checked("versions", _versions)
    yield _checked("state folder", lambda: _state(settings))
    yield _checked("database", lambda: _database(settings))
    yield _checked("backups", lambda: _backups(settings, clock))
    yield _checked("port", lambda: _port(settings, running))
    yield _checked("clock", _clock)
    yield _checked("camera", lambda: _camera(settings, clock) if running is None else _camera_in_use(running))


def run_camera_checks(settings: Settings, *, clock: Clock) -> Iterator[CheckResult]:
    """Run the checks of the camera alone; the results are what `sunarc check --camera` prints."""
    running = _running(settings)
    if running is not None:
        outcome, text = _camera_in_use(running)
        yield CheckResult("camera", outcome, f"{text}; stop the service to look closer")
        return
    yield from survey(settings, clock=clock)


def _checked(what: str, check_it: Callable[[], tuple[Outcome, str]]) -> CheckResult:
    try:
        outcome, text = check_it()
    except SunarcError as error:
        outcome, text = "fail", str(error)
    except PermissionError as error:
        outcome, text = "fail", f"{error.filename} is not for this user; look as root, or as the service's user"
    return CheckResult(what, outcome, text)


def _state(settings: Settings) -> tuple[Outcome, str]:
    prepare_state(settings.state)
    free = shutil.disk_usage(settings.state).free
    text = f"{free / 1e9:.1f} GB free"
    return ("ok", text) if free > _LEAST_FREE_BYTES else ("warn", f"only {text}; free some space")


def _database(settings: Settings) -> tuple[Outcome, str]:
    if settings.store is not None:
        with open_archive(settings.archive) as archive:
            require_stored_site(archive, settings)
        return "ok", f"PostgreSQL, revision {head_revision()}"
    if not settings.database.exists() or settings.database.stat().st_size == 0:
        copy = newest_sound_copy(settings.backups)
        if copy is not None:
            return "warn", f"missing or empty; the service restores it from {copy} at its start"
        return "ok", "none yet; the service makes it"
    found = check(settings.database)
    if found.sound:
        with open_archive(settings.database) as archive:
            require_stored_site(archive, settings)
        return "ok", f"revision {found.revision}, {found.rows.get('sun_point', 0)} sightings"
    if found.revision != found.head:
        return "warn", f"revision {found.revision}, not {found.head}; run sunarc db upgrade --state {settings.state}"
    what = (
        "; ".join(found.integrity) or f"the current calibration {', '.join(found.damaged)} does not match its checksum"
    )
    return "fail", f"damaged: {what}; stop the service, then sunarc db restore --latest --state {settings.state}"


def _backups(settings: Settings, clock: Clock) -> tuple[Outcome, str]:
    if settings.store is not None:
        return "ok", "those of PostgreSQL are its administrator's (pg_dump, see docs/fleet.md)"
    copies = sorted(settings.backups.glob("sunarc-*.sqlite"))
    if not copies:
        return "ok", "none yet; sunarc-backup.timer, or sunarc db backup, makes them"
    made = utc_time(copies[-1].stat().st_mtime)
    text = f"{len(copies)}, the newest of {made:%Y-%m-%d %H:%M} UTC"
    recent = clock.now() - made < _OLDEST_BACKUP
    return ("ok", text) if recent else ("warn", f"{text}; see systemctl status sunarc-backup.timer")


def _versions() -> tuple[Outcome, str]:
    python = ".".join(str(part) for part in sys.version_info[:3])
    return "ok", f"sunarc {sunarc.__version__}, Python {python}, numpy {version('numpy')}, numba {version('numba')}"


def _running(settings: Settings) -> dict[str, Any] | None:
    """Return the status of the service that runs with these settings; None when none answers."""
    host = f"[{settings.api.host}]" if ":" in settings.api.host else settings.api.host
    try:
        with urllib.request.urlopen(f"http://{host}:{settings.api.port}/v1/status", timeout=_ANSWER_S) as answer:
            status = json.load(answer)
    except (OSError, ValueError):
        return None
    return status if isinstance(status, dict) and status.get("camera_name") == settings.name else None


def _port(settings: Settings, running: Mapping[str, Any] | None) -> tuple[Outcome, str]:
    if running is not None:
        return "ok", f"{settings.api.port} at {settings.api.host}: the service answers, {running['health']}"
    listen(settings.api.host, settings.api.port).close()
    return "ok", f"{settings.api.port} at {settings.api.host} is free"


def _camera_in_use(running: Mapping[str, Any]) -> tuple[Outcome, str]:
    camera = running.get("camera") or {}
    if camera.get("connected"):
        return "ok", f"the running service holds {camera['model']} at {camera['address']}"
    text = [reason["text"] for reason in running["reasons"] if reason["code"] == "camera_lost"]
    return "fail", f"the running service has lost it: {'; '.join(text) or 'no reason text'}; power, cable, address"


def _clock() -> tuple[Outcome, str]:
    state = host_clock_state()
    if not state.synchronised:
        return "warn", "not synchronised; start systemd-timesyncd or chrony and let it reach its servers"
    text = f"synchronised to within {state.error_bound_s:.3f} s"
    return ("ok", text) if state.error_bound_s < _LARGEST_CLOCK_ERROR_S else ("warn", f"{text}; wait for it to settle")


def _camera(settings: Settings, clock: Clock) -> tuple[Outcome, str]:
    with closing(camera_opener(settings, clock)()) as camera:
        info = camera.info
        frame = camera.expose(
            min(max(settings.capture.hdr_exposures_us[0], info.exposure_min_us), info.exposure_max_us)
        )
    return "ok", (
        f"{info.vendor} {info.model} at {info.address}: {info.width}x{info.height} {info.pixel_format}, "
        f"{info.exposure_min_us:g} to {info.exposure_max_us:g} us; a frame of {frame.exposure_us:g} us was complete"
    )
