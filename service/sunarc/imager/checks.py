"""Checks of everything that the service needs, each with the remedy where it fails."""

from __future__ import annotations

import json
import os
import shutil
import socket
import sys
import tempfile
import threading
import urllib.parse
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from datetime import timedelta
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, NamedTuple

import sunarc
from sunarc.common import errors
from sunarc.common.array_types import Image
from sunarc.common.findings import Finding
from sunarc.common.foreign_files import name_text
from sunarc.common.utc import utc_time
from sunarc.imager.app.cameras import camera_opener, require_stored_site
from sunarc.imager.app.pushing import receivers
from sunarc.imager.app.service import night_capture
from sunarc.imager.app.serving import load_credentials
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.database.backup import newest_sound_copy
from sunarc.imager.archive.database.schema import check, head_revision
from sunarc.imager.archive.database.state_folder import as_owner
from sunarc.imager.archive.outbox import OutboxPosition
from sunarc.imager.cameras.aravis import AravisCamera, open_aravis
from sunarc.imager.cameras.frame import SkyCamera
from sunarc.imager.cameras.options import AravisOptions, FolderOptions
from sunarc.imager.commands.first_look import TriedPicture, judge_site, look_for_sun, small_picture, try_pictures
from sunarc.imager.live.folder_conditions import time_rules
from sunarc.imager.live.folder_files import is_image
from sunarc.imager.live.rtsp import make_client
from sunarc.imager.runtime import http_exchange
from sunarc.imager.runtime.clock import Clock, SystemClock, host_clock_state
from sunarc.imager.runtime.host import listen, prepare_state
from sunarc.imager.settings.model import Settings
from sunarc.imager.web.middleware.admission import read_token
from sunarc.imager.workers.calibrating.provisional_pose import FirstPose
from sunarc.imager.workers.hub_connection import HubConnection, HubRefusal
from sunarc.imager.workers.push import Sink
from sunarc.sky.site import Site
from sunarc.sources.image_files import read_one_image
from sunarc.sources.sources import Folder, open_folder

# Checks of a camera: abilities, stream, exposures, and a few trial frames.

Outcome = Literal["ok", "warn", "fail"]
_TRIAL_FRAMES = 12
_SHORT_US = 100.0
SILENT = (
    "the camera answers commands, but no packet of a frame arrives: let UDP from its address through this host's "
    "firewall, and see that its packets are not above the network's MTU and that it takes software triggers"
)


class CheckResult(NamedTuple):
    """Result of one check.

    Attributes
    ----------
    what : what was checked.
    outcome : "ok", "warn" (the service runs, with less) or "fail".
    text : what was found, with the remedy where one is needed.
    """

    what: str
    outcome: Outcome
    text: str


class TriedResult(NamedTuple):
    """Result of a trial of new settings, as `CheckResult`, with the codes of the findings that decided."""

    what: str
    outcome: Outcome
    text: str
    codes: tuple[str, ...] = ()


def survey(settings: Settings, *, clock: Clock) -> Iterator[CheckResult]:
    """Open the camera as the service would, and run the checks of it."""
    try:
        camera = camera_opener(settings, clock)()
    except errors.SunarcError as error:
        yield CheckResult("camera", "fail", str(error))
        return
    with closing(camera):
        yield _check_identity(camera)
        if isinstance(camera, AravisCamera):
            yield from (CheckResult(what, "ok", text) for what, text in camera.abilities())
            yield from _check_stream(camera)
        yield check_exposures(camera, settings.capture.hdr_exposures_us)
        yield check_frames(camera, settings.capture.hdr_exposures_us)


def _check_identity(camera: SkyCamera) -> CheckResult:
    info = camera.info
    text = f"{info.vendor} {info.model} ({info.serial or 'no serial number'}) at {info.address}"
    return CheckResult("camera", "ok", f"{text}: {info.width}x{info.height} px in {info.pixel_format} will be used")


def _check_stream(camera: AravisCamera) -> Iterator[CheckResult]:
    if camera.link is not None:
        yield CheckResult("stream", "ok", camera.link.text)
        yield from (CheckResult("stream", "warn", text) for text in camera.link.complaints)


def check_exposures(camera: SkyCamera, requested_us: Sequence[float]) -> CheckResult:
    """Check that the camera can take the requested exposures."""
    info = camera.info
    step = f" in steps of {info.exposure_step_us:g}" if info.exposure_step_us > 0.0 else ""
    text = f"{info.exposure_min_us:.8g} to {info.exposure_max_us:.8g} us{step}"
    beyond = info.unreachable(requested_us)
    if beyond is not None:
        return CheckResult("exposures", "fail", f"{beyond}: change capture.hdr_exposures_us")
    if info.exposure_min_us > _SHORT_US:
        return CheckResult(
            "exposures", "warn", f"{text}; that is long for the sun: see that its disc stays small, or fit a filter"
        )
    return CheckResult("exposures", "ok", text)


def check_frames(camera: SkyCamera, exposures_us: Sequence[float]) -> CheckResult:
    """Take some frames, and report how many were complete."""
    lost, silent, refused, last = 0, 0, 0, ""
    for number in range(_TRIAL_FRAMES):
        try:
            camera.expose(exposures_us[number % len(exposures_us)])
        except errors.CameraTimeoutError as error:
            lost, silent, last = lost + 1, silent + isinstance(error, errors.CameraSilentError), str(error)
        except errors.CameraError as error:
            refused, last = refused + 1, str(error)
    complete = _TRIAL_FRAMES - lost - refused
    text = f"{complete} of {_TRIAL_FRAMES} frames complete"
    if complete == _TRIAL_FRAMES:
        return CheckResult("frames", "ok", text)
    if silent == _TRIAL_FRAMES:
        return CheckResult("frames", "fail", f"{text}; {SILENT}")
    remedy = "look at packet size, MTU and net.core.rmem_max" if lost else "see what else sets the camera"
    return CheckResult("frames", "warn" if complete else "fail", f"{text}; the last fault: {last}; {remedy}")


_LEAST_FREE_BYTES = 2_000_000_000
_LARGEST_CLOCK_ERROR_S = 1.0
_OLDEST_BACKUP = timedelta(days=3)
_ANSWER_S = 2.0
_MOST_STATUS_BYTES = 1_000_000
"""Of the answer of whatever listens at the service's port; a status has some kilobytes."""
_RECEIVER_S = 12.0
"""For a receiver of messages or rows, its name's resolution included; a broker has 10 s, see `MqttBroker`."""


def run_checks(settings: Settings, *, clock: Clock) -> Iterator[CheckResult]:
    """Run all checks; the results are the output of `sunarc check`."""
    running = _ask_running_service(settings)
    yield CheckResult("settings", "ok", f"camera {settings.name!r}, state in {settings.state}")
    yield _run_check("versions", _check_versions)
    with as_owner(settings.state):
        yield _run_check("state folder", lambda: _check_state_folder(settings))
        yield _run_check("database", lambda: _check_database(settings))
        yield _run_check("backups", lambda: _check_backups(settings, clock))
    yield _run_check("port", lambda: _check_port(settings, running))
    yield _run_check("clock", check_clock)
    with as_owner(settings.state):
        yield from _check_optional_parts(settings, clock)
    if settings.source == "folder" and settings.folder is not None:
        with as_owner(settings.state):
            yield from (CheckResult(*tried[:3]) for tried in _try_pictures(settings.folder, settings.place, None))
    elif settings.source in {"http", "rtsp"}:
        with as_owner(settings.state):
            yield _run_check(f"picture at {settings.source}.url", lambda: _try_snapshot(settings, None)[:2])
    else:
        yield _run_check(
            "camera", lambda: _check_camera(settings, clock) if running is None else _check_camera_in_use(running)
        )


def run_camera_checks(settings: Settings, *, clock: Clock) -> Iterator[CheckResult]:
    """Run the checks of the camera alone; the results are the output of `sunarc check --camera`."""
    running = _ask_running_service(settings)
    if running is not None:
        outcome, text = _check_camera_in_use(running)
        yield CheckResult("camera", outcome, f"{text}; stop the service to look closer")
        return
    yield from survey(settings, clock=clock)


_PICTURES = 16
"""Pictures of a folder that are read: on a small computer a few seconds for each."""
_QUESTIONS = {
    "database": "--latitude, --longitude, --altitude, --name",
    "state folder": "--state",
    "backups": "--state",
    "port": "--port",
    "camera": "--camera",
    "folder": "--folder",
    "picture": "--utc-offset, --time-pattern",
    "picture at http.url": "--url, --token-file",
    "picture at rtsp.url": "--url, --token-file",
    "site": "--latitude, --longitude",
    "clock": "no option: it looks again",
}
"""The options of `sunarc init` that answer the complaints of a check."""


def init_option(result: CheckResult | TriedResult) -> str | None:
    """Return the option of `sunarc init` that answers a complaint; None without one, and without a complaint."""
    return None if result.outcome == "ok" else _QUESTIONS.get(result.what)


def try_first(settings: Settings, *, addresses: Sequence[str], picture: Path) -> Iterator[TriedResult]:
    """Try the parts that a new settings file names: cameras, pictures, site, clock and disk.

    Parameters
    ----------
    settings : of the new file.
    addresses : of GigE cameras that are asked whether they answer, besides the settings' own.
    picture : where a small picture of the source is written.
    """
    clock = SystemClock()
    if settings.source == "aravis":
        yield from (TriedResult(*result) for result in _check_camera_addresses(settings, addresses, clock))
    elif settings.folder is not None and settings.source == "folder":
        yield from _try_pictures(settings.folder, settings.place, picture)
    elif settings.source in {"http", "rtsp"}:
        codes: list[str] = []

        def try_it() -> tuple[Outcome, str]:
            outcome, text, code = _try_snapshot(settings, picture)
            codes.extend([code] if code else [])
            return outcome, text

        yield TriedResult(*_run_check(f"picture at {settings.source}.url", try_it), codes=tuple(codes))
    yield TriedResult(*_run_check("clock", check_clock))
    yield TriedResult(*_run_check("disk", lambda: _check_room(settings.state)))


def _check_camera_addresses(settings: Settings, addresses: Sequence[str], clock: Clock) -> Iterator[CheckResult]:
    """Connect to each address in turn; the settings' camera has to answer, for the others it is only reported."""
    options = settings.camera
    if options is None:
        return
    for address in dict.fromkeys((options.address, *addresses)):
        result = _run_check("camera", partial(_identify_camera, replace(options, address=address), clock))
        own = address == options.address
        yield result if own or result.outcome == "ok" else result._replace(outcome="warn")


def _identify_camera(options: AravisOptions, clock: Clock) -> tuple[Outcome, str]:
    with closing(open_aravis(options, clock)) as camera:
        found = _check_identity(camera)
    return found.outcome, found.text


def _try_pictures(options: FolderOptions, site: Site, picture: Path | None) -> Iterator[TriedResult]:
    """Read pictures of a folder: whether they can be read, when they were taken, where the sun is in them."""
    if options.path.exists() and not os.access(options.path, os.R_OK | os.X_OK, effective_ids=True):
        text = f"{options.path} is not for this user; let the service's user read it, with all that is in it"
        yield TriedResult("folder", "fail", text, ("folder_not_permitted",))
        return
    if not options.path.is_dir():
        text = f"{options.path} is no folder; give --folder, or let the other program make it"
        yield TriedResult("folder", "fail", text, ("folder_missing",))
        return
    source = open_folder(options.path, follow_exif=options.follow_exif)
    names = [file.name for file in source.files() if is_image(file.name, options.files)]
    rules = time_rules(options)

    unwritten: list[str] = []

    def show(tried: TriedPicture, image: Image) -> None:
        if picture is None:
            return
        try:
            _write_small(picture, image, tried)
        except errors.OutsideError as error:
            unwritten.append(f"{error}; give --picture")

    tried = list(try_pictures(source, names, rules, most=_PICTURES, on_image=show))
    if not tried:
        finding = Finding("folder_without_images", {"path": str(options.path)})
        yield TriedResult("folder", "warn", _make_sentence(finding), (finding.code,))
        return
    yield _make_picture_result(tried[0], len(names), picture)
    yield from (TriedResult("small picture", "warn", text) for text in unwritten)
    faults = {fault.code: one for one in tried[1:] for fault in one.faults}
    for code in faults.keys() - {fault.code for fault in tried[0].faults}:
        yield TriedResult("picture", "warn", f"{faults[code].name}: {faults[code].describe()}", (code,))
    judged = judge_site(tried, site)
    good = judged.code == "site_agrees"
    yield TriedResult("site", "ok" if good else "warn", _make_sentence(judged), (judged.code,))


def _try_snapshot(settings: Settings, shown: Path | None) -> tuple[Outcome, str, str]:
    """Ask a camera for its picture as the service does; return the code of the fault, too."""
    options = settings.rtsp if settings.source == "rtsp" else settings.http
    if options is None:
        return "fail", f"setting {settings.source} is missing", ""
    found = make_client(options, SystemClock(), dated_by_camera=settings.dated_by_camera).picture()
    if isinstance(found, Finding):
        return "fail", f"{found.sentence} [{found.code}]", found.code
    with tempfile.TemporaryDirectory() as place:
        name = f"picture.{found.suffix}"
        (Path(place) / name).write_bytes(found.content)
        image = read_one_image(Folder(name_text(place)), name)
    if isinstance(image, Finding):
        return "fail", f"{image.sentence} [{image.code}]", image.code
    rule = "its Last-Modified" if settings.dated_by_camera else "this host's clock"
    tried = look_for_sun(TriedPicture(name=name, time=found.time, rule=rule), image)
    if shown is not None:
        _write_small(shown, image, tried)
    judged = judge_site([tried], settings.place)
    if judged.code == "site_sun_down":
        return "warn", f"{tried.describe()}; {_make_sentence(judged)}", judged.code
    return "ok", tried.describe() + ("" if shown is None else f"; see {shown}"), ""


def _write_small(target: Path, image: Image, tried: TriedPicture) -> None:
    with as_owner(target.parent), errors.disk_errors(target):
        target.write_bytes(small_picture(image, tried.found))


def _make_picture_result(tried: TriedPicture, files: int, picture: Path | None) -> TriedResult:
    shown = "" if tried.size is None or picture is None else f"; see {picture}"
    codes = tuple(fault.code for fault in tried.faults)
    text = f"{tried.name}, one of {files}: {tried.describe()}{shown}"
    return TriedResult("picture", "fail" if codes else "ok", text, codes)


def _make_sentence(finding: Finding) -> str:
    remedy = finding.remedy
    return finding.text + ("" if remedy == "none" else f"; {remedy}") + f" [{finding.code}]"


def _check_room(state: Path) -> tuple[Outcome, str]:
    """Return how much room there is where the state folder is, or will be."""
    there = next(folder for folder in (state, *state.absolute().parents) if folder.exists())
    free = shutil.disk_usage(there).free
    text = f"{state}: {free / 1e9:.1f} GB free"
    return ("ok", text) if free > _LEAST_FREE_BYTES else ("warn", f"only {text}; free some space, or give --state")


def _check_optional_parts(settings: Settings, clock: Clock) -> Iterator[CheckResult]:
    """Try the parts that the settings enable, as `serve` does; disabled parts give no result."""
    access = load_credentials(settings.api)
    for name, path in (("token_file", access.token_file), ("read_token_file", access.read_token_file)):
        if path is not None:
            yield _run_check(f"api.{name}", partial(_check_token, path, f"api.{name}"))
    if settings.first_pose.lens_prior is not None:
        yield _run_check("lens prior", lambda: _report_ok(FirstPose.of(settings.first_pose), "read"))
    if settings.night.enabled:
        yield _run_check(
            "night", lambda: _report_ok(night_capture(settings.night, lambda _: settings.place), "possible")
        )
    if settings.hub.url is not None:
        yield _run_check("hub", lambda: _check_hub(settings))
    for sink in receivers(settings.push, states=dict, clock=clock, client=settings.name):
        yield _run_check(sink.name, partial(_check_receiver, sink))


def _report_ok(_result: object, text: str) -> tuple[Outcome, str]:
    return "ok", text


def _check_token(path: Path, setting: str) -> tuple[Outcome, str]:
    return _report_ok(read_token(path, setting=setting), "read")


def _check_receiver(sink: Sink) -> tuple[Outcome, str]:
    try:
        _call_with_limit(sink.probe)
    except errors.OutsideError as error:
        return "warn", f"{error}; messages wait until it answers; check its address in the settings, and the network"
    return "ok", "it takes the connection"


def _check_hub(settings: Settings) -> tuple[Outcome, str]:
    """Send no rows to the hub, with the token, as the service does; before its first start only connect."""
    connection, position = (
        HubConnection(settings.hub, camera=settings.name, clock=SystemClock()),
        _read_outbox_position(settings),
    )
    try:
        if position is None:
            _call_with_limit(partial(_try_connection, str(settings.hub.url)))
            return "ok", "it takes the connection; the token is tried at the first start"
        # After -1: the hub answers where it stands, and stores nothing.
        _call_with_limit(lambda: connection.send(replace(position, committed=-1), [], lambda: None))
    except HubRefusal as refusal:
        raise errors.ConfigurationError(f"the hub refuses with {refusal.status}: {refusal}") from None
    except errors.OutsideError as error:
        return "warn", f"{error}; rows wait until it answers; check hub.url and the network"
    return "ok", "it takes the token"


def _read_outbox_position(settings: Settings) -> OutboxPosition | None:
    if settings.store is None and not (settings.database.exists() and settings.database.stat().st_size):
        return None
    with open_archive(settings.archive) as archive:
        return archive.outbox.position() if archive.outbox.enabled() else None


def _try_connection(url: str) -> None:
    parts = urllib.parse.urlsplit(url)
    try:
        port = parts.port or (443 if parts.scheme == "https" else 80)
        socket.create_connection((parts.hostname or "", port), timeout=_ANSWER_S).close()
    except (OSError, ValueError) as error:
        raise errors.OutsideError(f"{parts.hostname}: {error}") from error


def _call_with_limit(call: Callable[[], object]) -> None:
    """Call something that waits for another host, for a limited time: a resolver may take a minute."""
    ended: list[BaseException | None] = []

    def run() -> None:
        try:
            call()
        except BaseException as error:  # noqa: BLE001 - raised in the thread that waits
            ended.append(error)
        else:
            ended.append(None)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(_RECEIVER_S)
    if not ended:
        raise errors.OutsideError(f"no answer within {_RECEIVER_S:g} s")
    if ended[0] is not None:
        raise ended[0]


def _run_check(what: str, check_it: Callable[[], tuple[Outcome, str]]) -> CheckResult:
    try:
        outcome, text = check_it()
    except errors.SunarcError as error:
        outcome, text = "fail", str(error)
    except PermissionError as error:
        outcome, text = "fail", f"{error.filename} is not for this user; look as root, or as the service's user"
    return CheckResult(what, outcome, text)


def _check_state_folder(settings: Settings) -> tuple[Outcome, str]:
    prepare_state(settings.state)
    free = shutil.disk_usage(settings.state).free
    text = f"{free / 1e9:.1f} GB free"
    return ("ok", text) if free > _LEAST_FREE_BYTES else ("warn", f"only {text}; free some space")


def _check_tables(archive: Archive, camera: str, kept: str) -> tuple[Outcome, str]:
    """Return the tables of a database that answer, and that a provisional calibration is served from it."""
    current = archive.calibrations.current_model(camera)
    if current is None or current.sigma_limit_deg is None:
        return "ok", kept
    return (
        "warn",
        f"{kept}; a provisional calibration answers where its 1-sigma is at most {current.sigma_limit_deg:g}°",
    )


def _check_database(settings: Settings) -> tuple[Outcome, str]:
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
            return _check_tables(
                archive, settings.name, f"revision {found.revision}, {found.rows.get('sun_point', 0)} sightings"
            )
    if found.revision != found.head:
        return "warn", f"revision {found.revision}, not {found.head}; run sunarc db upgrade --state {settings.state}"
    what = (
        "; ".join(found.integrity) or f"the current calibration {', '.join(found.damaged)} does not match its checksum"
    )
    return "fail", f"damaged: {what}; stop the service, then sunarc db restore --latest --state {settings.state}"


def _check_backups(settings: Settings, clock: Clock) -> tuple[Outcome, str]:
    if settings.store is not None:
        return "ok", "those of PostgreSQL are its administrator's (pg_dump, see docs/fleet.md)"
    copies = sorted(settings.backups.glob("sunarc-*.sqlite"))
    if not copies:
        return "ok", "none yet; sunarc-backup.timer, or sunarc db backup, makes them"
    made = utc_time(copies[-1].stat().st_mtime)
    text = f"{len(copies)}, the newest of {made:%Y-%m-%d %H:%M} UTC"
    recent = clock.now() - made < _OLDEST_BACKUP
    return ("ok", text) if recent else ("warn", f"{text}; see systemctl status sunarc-backup.timer")


def _check_versions() -> tuple[Outcome, str]:
    python = ".".join(str(part) for part in sys.version_info[:3])
    return "ok", f"sunarc {sunarc.__version__}, Python {python}, numpy {version('numpy')}"


def _ask_running_service(settings: Settings) -> dict[str, Any] | None:
    """Return the status of the service that runs with these settings; None when none answers."""
    host = f"[{settings.api.host}]" if ":" in settings.api.host else settings.api.host
    url = urllib.parse.urlsplit(f"http://{host}:{settings.api.port}/v1/status")
    limit = http_exchange.Limit(_ANSWER_S, monotonic=SystemClock().monotonic, heartbeat=lambda: None)
    request = http_exchange.HttpRequest(method="GET", url=url, headers={}, body=b"")
    try:
        answer = http_exchange.fetch(request, context=None, limit=limit, most_bytes=_MOST_STATUS_BYTES)
        status = json.loads(answer.body)
    except (OSError, ValueError, http_exchange.UnfinishedError):
        return None
    return status if isinstance(status, dict) and status.get("camera_name") == settings.name else None


def _check_port(settings: Settings, running: Mapping[str, Any] | None) -> tuple[Outcome, str]:
    if running is not None:
        return "ok", f"{settings.api.port} at {settings.api.host}: the service answers, {running['health']}"
    listen(settings.api.host, settings.api.port).close()
    return "ok", f"{settings.api.port} at {settings.api.host} is free"


def _check_camera_in_use(running: Mapping[str, Any]) -> tuple[Outcome, str]:
    camera = running.get("camera") or {}
    if camera.get("connected"):
        return "ok", f"the running service holds {camera['model']} at {camera['address']}"
    text = [reason["text"] for reason in running["reasons"] if reason["code"] == "camera_lost"]
    return "fail", f"the running service has lost it: {'; '.join(text) or 'no reason text'}; power, cable, address"


def check_clock() -> tuple[Outcome, str]:
    """Check that the host's clock is synchronised."""
    state = host_clock_state()
    if not state.synchronised:
        return "warn", "not synchronised; start systemd-timesyncd or chrony and let it reach its servers"
    text = f"synchronised to within {state.error_bound_s:.3f} s"
    return ("ok", text) if state.error_bound_s < _LARGEST_CLOCK_ERROR_S else ("warn", f"{text}; wait for it to settle")


def _check_camera(settings: Settings, clock: Clock) -> tuple[Outcome, str]:
    with closing(camera_opener(settings, clock)()) as camera:
        info = camera.info
        frame = camera.expose(
            min(max(settings.capture.hdr_exposures_us[0], info.exposure_min_us), info.exposure_max_us)
        )
    return "ok", (
        f"{info.vendor} {info.model} at {info.address}: {info.width}x{info.height} {info.pixel_format}, "
        f"{info.exposure_min_us:g} to {info.exposure_max_us:g} us; a frame of {frame.exposure_us:g} us was complete"
    )
