"""The whole chain on one machine: a simulated imager (GigE Vision) on loopback, the service, an embedded database."""

from __future__ import annotations

import argparse
import json
import os
import secrets
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SITE = {"latitude": 36.604043, "longitude": -97.484856, "altitude": 318.0}  # ARM SGP, as in the paper
FIRST_DAY = "2013-05-13"
CAMERA_ADDRESS = "127.0.0.1"
GVCP_PORT = 3956
BUFFER_LIMIT = Path("/proc/sys/net/core/rmem_max")
BUFFER_BYTES = 32 * 1024 * 1024
CADENCE_S = 120.0
NIGHT_CADENCE_S = 600.0
POLL_S = 0.5
START_WITHIN_S = 300.0
PACE_SLOTS = 10
"""Slots with the sun up between two looks at how many were missed."""
MISSED_SHARE = 0.5
"""Share of them without an evaluated sun exposure from which on the simulated time is slowed."""
MOST_UNNAMED = 2
"""Nights without a calibration that are waited out; then the demo ends all the same."""
SLOWEST = 10.0
"""Speed that the imager is not slowed below."""


class DemoError(Exception):
    """Ends the demo with one line."""


def main() -> int:
    """Run the demo and return its exit code: 0 done, 1 not calibrated, 2 usage, 3 something outside failed."""
    options = parse_arguments()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # both end the imager and the service on the way out
    try:
        return run(options)
    except DemoError as error:
        print(f"demo: {error}", file=sys.stderr)
        return 3
    except KeyboardInterrupt:
        return 0


def parse_arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="deploy/demo", description=__doc__)
    parser.add_argument("--headless", action="store_true", help="end by itself once the days are over")
    parser.add_argument("--days", type=int, default=1, metavar="N", help="simulated days (default 1)")
    parser.add_argument("--speed", type=float, default=240.0, metavar="X", help="times faster than real (default 240)")
    parser.add_argument(
        "--cadence",
        type=float,
        default=CADENCE_S,
        metavar="S",
        help=f"simulated seconds a cycle (default {CADENCE_S:g})",
    )
    parser.add_argument("--port", type=int, default=8080, metavar="P", help="of the dashboard (default 8080)")
    parser.add_argument("--state", type=Path, metavar="DIR", help="an empty folder (default: a new one)")
    parser.add_argument("--until-calibrated", action="store_true", help="exit 0 only when a calibration is current")
    parser.add_argument("--lens-seed", type=int, default=0, metavar="N", help="draw another true camera")
    parser.add_argument("--clouds", default="clear", help="clear, veil, broken, overcast; several by commas: one a day")
    parser.add_argument("--keep", action="store_true", help="with --headless: go on serving")
    parser.add_argument("--nights", action="store_true", help="look at the stars in the nights, too")
    parser.add_argument("--bump", type=float, metavar="DEG", help="turn the camera by so much, at the time --at")
    parser.add_argument(
        "--at", metavar="TIME", help=f"simulated time, as {FIRST_DAY}T18:00:00Z; at noon of the first day unless given"
    )
    other = parser.add_mutually_exclusive_group()
    for source, what in (("folder", "a program writes pictures into a folder"), ("http", "a camera gives its picture")):
        other.add_argument(f"--{source}", dest="source", action="store_const", const=source, help=f"{what} instead")
    parser.add_argument("--archive", action="store_true", help="make a small archive of images and analyse it instead")
    parser.add_argument("--setup-only", action="store_true", help="set up and stop")
    options = parser.parse_args()
    options.camera_port = free_port() if options.source == "http" else None
    bounded = 1.0 <= options.speed <= 2000.0 and 30.0 <= options.cadence <= 600.0
    if options.days < 1 or not bounded or not 0 < options.port < 65536:
        parser.error("--days must be 1 or more, --speed 1 to 2000, --cadence 30 to 600, --port 1 to 65535")
    return options


def run(options: argparse.Namespace) -> int:
    """Start the imager and the service, follow them, and leave the results in the state folder."""
    state = prepare_state(options.state)
    if options.archive:
        return analyse_archive(state)
    if options.source is None:
        require_free_camera_port()
        allow_whole_frames()
    config = write_config(state, options)
    with ExitStack() as stack:
        print(f"demo: simulated imager: {place_of(state, options)}, {options.speed:g} times faster; state in {state}")
        stack.enter_context(running("imager", simulate_command(state, options), log=state / "imager.log"))
        wait_for((state / "truth.json").exists, what="the simulated imager", log=state / "imager.log")
        stack.enter_context(running("service", serve_command(config), log=state / "service.log"))
        url = f"http://127.0.0.1:{options.port}"
        wait_for(lambda: answers(f"{url}/healthz"), what="the service", log=state / "service.log")
        print(f"demo: dashboard at {url}/; the token for changes, as to acknowledge an event, is in {state}/token")
        code = follow(url, state, options)
        if not options.headless or options.keep:
            print(f"demo: goes on serving at {url}/ until Ctrl-C")
            signal.pause()
    return code


def analyse_archive(state: Path) -> int:
    """Make an archive of four cameras in the state folder, analyse it, and say where the report is."""
    from sunarc.lab.simulation.made_archive import FOUR_CAMERAS, MadeArchive, write_archive  # noqa: PLC0415 - slow to load

    made = MadeArchive(cameras=FOUR_CAMERAS, per_day=24, size=320)
    print(f"demo: making {made.days * made.per_day * len(made.cameras)} images of four cameras in {state / 'archive'}")
    cameras = write_archive(made, state / "archive")
    site = [f"--{name}={value}" for name, value in SITE.items()]
    command = [
        sys.executable,
        "-m",
        "sunarc",
        "reanalyse",
        f"--cameras={cameras}",
        *site,
        f"--output={state / 'result'}",
        "--yes",
    ]
    print(f"demo: {' '.join(command)}", flush=True)
    return subprocess.run(command, check=False).returncode


def prepare_state(folder: Path | None) -> Path:
    """Return a folder that holds no earlier state."""
    state = Path(tempfile.mkdtemp(prefix="sunarc-demo-")) if folder is None else folder.resolve()
    try:
        state.mkdir(parents=True, exist_ok=True)
        if any(state.iterdir()):
            raise DemoError(f"{state} is not empty; give --state an empty folder")
        (state / "writable").touch()
        (state / "writable").unlink()
    except OSError as error:
        raise DemoError(f"{state} cannot be used: {error.strerror}; give --state a folder you may write to") from None
    return state


def require_free_camera_port() -> None:
    """Raise when another imager answers on loopback already."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as trial:
        try:
            trial.bind((CAMERA_ADDRESS, GVCP_PORT))
        except OSError:
            raise DemoError(
                f"UDP port {GVCP_PORT} at {CAMERA_ADDRESS} is taken; end the other simulated imager"
            ) from None


def allow_whole_frames() -> None:
    """Let a socket hold a whole frame, as the package's sysctl setting does; it lasts until the next boot."""
    if int(BUFFER_LIMIT.read_text()) >= BUFFER_BYTES:
        return
    setting = ["sysctl", "-q", "-w", f"net.core.rmem_max={BUFFER_BYTES}"]
    command = setting if os.geteuid() == 0 else ["sudo", "-n", *setting]
    if subprocess.run(command, capture_output=True, check=False).returncode == 0:
        print(
            f"demo: net.core.rmem_max is now {BUFFER_BYTES} until the next boot, so that no packet of a frame is lost"
        )
    else:
        print(f"demo: frames may be lost; as root, run: {' '.join(setting)}")


def write_config(state: Path, options: argparse.Namespace) -> Path:
    """Write the service's settings, and a token for changes."""
    token = state / "token"
    token.touch(mode=0o600)
    token.write_text(f"{secrets.token_urlsafe(24)}\n")
    config = state / "sunarc.toml"
    config.write_text(
        f"""\
name = "demo"
state = "{state}"
source = "{options.source or "aravis"}"

[site]
latitude = {SITE["latitude"]}
longitude = {SITE["longitude"]}
altitude = {SITE["altitude"]}

{source_sections(state, options)}
[capture]
cadence_s = {options.cadence}
night_cadence_s = {NIGHT_CADENCE_S if options.nights else options.cadence}
speed = {options.speed}

[night]
enabled = {str(options.nights).lower()}

[sensor]
black_level_fraction = 0.0078

[refit]
check_every_s = 1.0

[api]
port = {options.port}
token_file = "{token}"
"""
    )
    return config


def source_sections(state: Path, options: argparse.Namespace) -> str:
    """Return the settings of the source."""
    if options.source == "folder":
        return f"""[folder]
path = "{place_of(state, options)}"
utc_offset = "0"
"""
    if options.source == "http":
        return f"""[http]
url = "http://{place_of(state, options)}/record/current.jpg"
"""
    return f"""[camera]
address = "{CAMERA_ADDRESS}"
pixel_format = "Mono12"
packet_size = 60000
packet_socket = false
timestamps = "camera"
"""


def place_of(state: Path, options: argparse.Namespace) -> str:
    """Return where the simulated camera is: its folder, or its address."""
    places = {"folder": str(state / "pictures"), "http": f"{CAMERA_ADDRESS}:{options.camera_port}"}
    return places.get(options.source, CAMERA_ADDRESS)


def free_port() -> int:
    """Return a port of loopback that is not in use."""
    with socket.socket() as trial:
        trial.bind((CAMERA_ADDRESS, 0))
        return int(trial.getsockname()[1])


def simulate_command(state: Path, options: argparse.Namespace) -> list[str]:
    """Return the command line of the simulated imager."""
    return [
        *("simulate", f"--{options.source or 'address'}", place_of(state, options), "--cadence", str(options.cadence)),
        *("--start", f"{FIRST_DAY}T11:00:00Z"),
        *("--latitude", str(SITE["latitude"]), "--longitude", str(SITE["longitude"])),
        *("--altitude", str(SITE["altitude"]), "--speed", str(options.speed)),
        *("--lens-seed", str(options.lens_seed), "--clouds", options.clouds, "--truth", str(state / "truth.json")),
        *(["--nights"] if options.nights else []),
        *(["--bump", str(options.bump), "--at", options.at or f"{FIRST_DAY}T18:00:00Z"] if options.bump else []),
    ]


def serve_command(config: Path) -> list[str]:
    """Return the command line of the service."""
    return ["serve", "--config", str(config)]


@contextmanager
def running(name: str, arguments: list[str], *, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a sunarc command in the background; end it on the way out."""
    environment = {**os.environ, "PYTHONUNBUFFERED": "1", "OPENBLAS_NUM_THREADS": "1"}
    with log.open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "sunarc", *arguments], stdout=output, stderr=output, env=environment
        )
    CHILDREN[name] = process
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(timeout=10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


CHILDREN: dict[str, subprocess.Popen[bytes]] = {}


def wait_for(ready: Callable[[], bool], *, what: str, log: Path) -> None:
    """Wait until something is ready, watching over the processes."""
    end = time.monotonic() + START_WITHIN_S
    while not ready():
        watch(log.parent)
        if time.monotonic() > end:
            raise DemoError(f"{what} did not start within {START_WITHIN_S:g} s; see {log}")
        time.sleep(POLL_S / 5)


def watch(state: Path) -> None:
    """Raise when a process has ended by itself."""
    for name, process in CHILDREN.items():
        if process.poll() is not None:
            log = state / f"{name}.log"
            lines = log.read_text(errors="replace").strip().splitlines() or ["it said nothing"]
            raise DemoError(f"the {name} ended with code {process.returncode}: {lines[-1]} (see {log})")


def answers(url: str) -> bool:
    """Return whether a URL answers at all."""
    try:
        get(url)
    except (OSError, urllib.error.URLError):
        return False
    return True


def get(url: str) -> Any:
    """Return a URL's JSON."""
    with urllib.request.urlopen(url, timeout=10.0) as response:
        return json.load(response)


def get_or_none(url: str) -> Any:
    """Return a URL's JSON, or None when it answers with an error."""
    try:
        return get(url)
    except urllib.error.HTTPError:
        return None


@dataclass
class Pace:
    """Halves the speed of the simulated time while the host is too busy to observe most slots.

    Attributes
    ----------
    speed : simulated seconds per real second.
    """

    speed: float
    _slots: int = 0
    _missed: int = 0
    _settling: bool = True  # at the start, and after each change, some slots are missed on any host

    def too_fast(self, capture: dict[str, Any]) -> str | None:
        """Return what to say where the speed has to be halved, None where it does not."""
        missed = capture["sun_missed"] + capture["sun_dropped"]
        slots = capture["cycles"] + capture["missed"]
        if slots - self._slots < PACE_SLOTS:
            return None
        new_slots, new_missed = slots - self._slots, missed - self._missed
        self._slots, self._missed = slots, missed
        settling, self._settling = self._settling, False
        if settling or new_missed < MISSED_SHARE * new_slots or self.speed / 2.0 < SLOWEST:
            return None
        self.speed, self._settling = self.speed / 2.0, True
        return (
            f"this host is too busy: {new_missed} of the last {new_slots} slots had no sun exposure; "
            f"slowing the simulated time to {self.speed:g} times real"
        )


def slow_down(pace: Pace, capture: dict[str, Any] | None) -> None:
    """Slow the imager, which the service follows, and say so."""
    said = None if capture is None else pace.too_fast(capture)
    if said is not None:
        CHILDREN["imager"].send_signal(signal.SIGUSR1)
        print(f"demo: {said}", flush=True)


def follow(url: str, state: Path, options: argparse.Namespace) -> int:
    """Show the progress until the days are over, save what is served, and return the exit code."""
    shown, pace = "", Pace(options.speed)
    while True:
        watch(state)
        days = get(f"{url}/v1/days")["days"]
        calibration = get_or_none(f"{url}/v1/calibration")
        status = get(f"{url}/v1/status")
        slow_down(pace, status.get("capture"))
        line = describe(days, calibration, status)  # a count of missed slots alone is no news
        if line != shown:
            print(f"demo: {line}{missed_slots(status)}", flush=True)
            shown = line
        if ended(url, days, options):
            break
        time.sleep(POLL_S)
    calibration = get_or_none(f"{url}/v1/calibration")
    if calibration is None:
        print("demo: the days are over and no calibration is current; see the dashboard's reasons")
        return 1 if options.until_calibrated else 0
    (state / "calibration.json").write_text(json.dumps(calibration, indent=1))
    if options.nights:
        compare_nights(url, state, calibration)
    print(f"demo: served calibration and true camera stand in {state}/calibration.json and truth.json")
    return 0


def ended(url: str, days: list[Any], options: argparse.Namespace) -> bool:
    """Return whether all days, and the nights after them, were judged, and their refits have ended."""
    if not options.nights:
        return len(days) >= options.days and not refit_under_way(url, days)
    nights = get(f"{url}/v1/events?kind=night")["events"]
    refits = get(f"{url}/v1/refits")["refits"]
    # on a busy host the first calibration may come after the first night, whose stars it could not name
    named = [night for night in nights if "night_without_calibration" not in codes_of(night)]
    enough = len(named) >= options.days or len(nights) >= options.days + MOST_UNNAMED
    return enough and not any(refit["state"] in {"requested", "running"} for refit in refits)


def codes_of(event: dict[str, Any]) -> list[str]:
    """Return the codes of an event's reasons."""
    return [found["code"] for found in event["details"].get("findings", [])]


def refit_under_way(url: str, days: list[Any]) -> bool:
    """Return whether the newest day was worth a refit whose end is not told yet."""
    newest = max(days, key=lambda day: str(day["date"]))
    if newest["verdict"] not in {"clear", "partly"}:
        return False
    events = get(f"{url}/v1/events")["events"]
    return not any(event["kind"].startswith("refit_") and event["time"] >= newest["decided_at"] for event in events)


def compare_nights(url: str, state: Path, served: Any) -> None:
    """Say how far the first calibration, of the sun alone, and the served one are from the truth; draw both."""
    from sunarc.lab.studies.sky_errors import sky_errors, write_picture  # noqa: PLC0415 - slow to load

    oldest = min(get(f"{url}/v1/calibrations?limit=1000")["calibrations"], key=lambda one: one["created_at"])
    first = get(f"{url}/v1/calibrations/{oldest['id']}")
    truth = json.loads((state / "truth.json").read_text())
    maps = {name: sky_errors(document, truth) for name, document in (("day", first), ("day and night", served))}
    for name, found in maps.items():
        print(
            f"demo: {name} ({found.calibration}): north {found.north_px:.3f} px, south {found.south_px:.3f} px (RMS "
            "from the truth, to 85 degrees of zenith angle)"
        )
    write_picture(maps, state / "nights.png")
    print(f"demo: drawn in {state}/nights.png")


def describe(days: list[Any], calibration: Any, status: Any) -> str:
    """Say in one line how far things are."""
    told = [f"{day['date']} {day['verdict']}" for day in days]
    seen = status.get("last_frame_at") or "no frame yet"
    fit = "no calibration yet"
    if calibration is not None:
        fit = f"calibration {calibration['id']}, {calibration['metrics']['rmse_px']:.3f} px RMSE"
    return f"{seen[:13].replace('T', ' ')} h; days judged: {', '.join(told) or 'none'}; {fit}"


def missed_slots(status: dict[str, Any]) -> str:
    """Return how many slots had no sun exposure, empty where all had one."""
    capture = status.get("capture") or {"sun_missed": 0}
    missed = capture["sun_missed"]
    if not missed:
        return ""
    return f"; {missed} of {capture['cycles'] + capture['missed']} slots without a sun exposure"


if __name__ == "__main__":
    sys.exit(main())
