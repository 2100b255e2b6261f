"""The first hour of a newcomer, done as docs/first-hour.md says it: from an installed `sunarc` to a served calibration.

    python -m tests.release.first_hour folder|http|gige [--sunarc COMMAND] [--speed X] [--wheel]

A simulated camera stands for the real one, and a day passes in minutes. Each step is timed, and what the newcomer sees
is printed. With --wheel the project's wheel is built first, and installed into a clean environment.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from tests.fixtures.ports import free_port

ROOT = Path(__file__).parents[2]
SITE = ("--latitude", "36°36'14.6\"N", "--longitude", "97°29'05.5\"W", "--altitude", "318")
WITHIN_S = 1800.0


class Newcomer:
    """One who types commands; each is timed, and its last lines are shown."""

    def __init__(self, sunarc: str, home: Path, speed: float) -> None:
        self.sunarc = sunarc
        self.home = home
        self.port = free_port()
        self.environment = {
            **os.environ,
            "OPENBLAS_NUM_THREADS": "1",
            "SUNARC_CAPTURE__SPEED": str(speed),
            "SUNARC_REFIT__CHECK_EVERY_S": "1.0",
        }

    def do(self, *command: str, codes: tuple[int, ...] = (0,)) -> str:
        """Run a command in the home folder, and return what it prints."""
        begin = time.monotonic()
        done = subprocess.run(
            command, cwd=self.home, env=self.environment, capture_output=True, text=True, timeout=WITHIN_S, check=False
        )
        print(f"$ {' '.join(command)}    # {time.monotonic() - begin:.1f} s, exit code {done.returncode}")
        print(done.stdout[-2500:] + done.stderr[-1000:], flush=True)
        if done.returncode not in codes:
            raise SystemExit(f"first hour: {command[0]} ended with {done.returncode}")
        return done.stdout

    @contextmanager
    def runs(self, *command: str) -> Iterator[None]:
        """Run a command beside the others."""
        print(f"$ {' '.join(command)} &", flush=True)
        with (self.home / f"{command[1]}.log").open("wb") as log:
            process = subprocess.Popen(command, cwd=self.home, env=self.environment, stdout=log, stderr=log)
            try:
                yield
            finally:
                process.terminate()
                process.wait(30.0)

    def wait_until(self, there: Callable[[], bool]) -> None:
        """Wait until something is there."""
        end = time.monotonic() + WITHIN_S
        while not there():
            if time.monotonic() > end:
                raise SystemExit(f"first hour: not there within {WITHIN_S:g} s; see {self.home}")
            time.sleep(0.5)

    def get(self, path: str) -> Any:
        """Return what the service answers; None where it does not, or has none."""
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self.port}{path}", timeout=10.0) as answer:
                return json.load(answer)
        except (OSError, urllib.error.URLError, ValueError):
            return None

    def wait_for(self, path: str, *, what: str) -> Any:
        """Wait until the service answers at a path, and say how long it took."""
        begin = time.monotonic()
        while time.monotonic() - begin < WITHIN_S:
            found = self.get(path)
            if found is not None:
                print(f"# {what} after {time.monotonic() - begin:.1f} s", flush=True)
                return found
            time.sleep(1.0)
        raise SystemExit(f"first hour: no {what} within {WITHIN_S:g} s; see {self.home}")


def main() -> int:
    """Run one of the ways."""
    parser = argparse.ArgumentParser(prog="tests.release.first_hour", description=__doc__)
    parser.add_argument("way", choices=("folder", "http", "gige"))
    parser.add_argument("--sunarc", default=shutil.which("sunarc") or "sunarc")
    parser.add_argument("--speed", type=float, default=240.0)
    parser.add_argument("--wheel", action="store_true")
    options = parser.parse_args()
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="first-hour-") as place:
        home = Path(place)
        sunarc = installed_wheel(home) if options.wheel else options.sunarc
        newcomer = Newcomer(sunarc, home, options.speed)
        way = {"folder": follow_folder, "http": ask_camera, "gige": follow_camera}[options.way]
        way(newcomer, options.speed)
    print(f"first hour: {options.way}: all steps, {time.monotonic() - begin:.0f} s")
    return 0


def installed_wheel(home: Path) -> str:
    """Build the wheel, install it into a new environment of Debian's python3, and return its command."""
    newcomer = Newcomer("", home, 1.0)
    newcomer.do(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(home / "dist"), str(ROOT))
    newcomer.do("/usr/bin/python3", "-m", "venv", str(home / "clean"))
    (wheel,) = (home / "dist").glob("sunarc-*.whl")
    newcomer.do(
        str(home / "clean/bin/pip"), "install", "--quiet", "--disable-pip-version-check", f"{wheel}[imager,archives]"
    )
    return str(home / "clean/bin/sunarc")


def follow_folder(newcomer: Newcomer, speed: float) -> None:
    """Follow a folder that another program fills: init, check, serve; then calibrate and reanalyse by hand."""
    sunarc, home = newcomer.sunarc, newcomer.home
    pictures = home / "pictures"
    simulate = ("simulate", "--folder", str(pictures), "--speed", str(speed), "--cadence", "120")
    with ExitStack() as running:
        running.enter_context(newcomer.runs(sunarc, *simulate, "--start", "2013-05-13T11:00:00Z"))
        while len(list(pictures.rglob("image-*.jpg"))) < 3:
            time.sleep(0.5)
        source = ("--folder", str(pictures), "--utc-offset", "0")
        newcomer.do(
            sunarc, "init", *SITE, *source, "--state", str(home / "state"), "--port", str(newcomer.port)
        )  # fmt: skip
        serve_until_calibrated(newcomer, running)
    (home / "points.csv").write_text(newcomer.do(sunarc, "points", "export", "--config", "sunarc.toml"))
    newcomer.do(sunarc, "calibrate", "points.csv", *decimal(), "--image-size", "640,640")
    newcomer.do(sunarc, "reanalyse", str(pictures), *decimal(), "--utc-offset", "0", "--yes", "-o", str(home / "again"))
    made = newcomer.do("ls", str(home / "again"))
    if "report.html" not in made:
        raise SystemExit("first hour: reanalyse wrote no report")


def ask_camera(newcomer: Newcomer, speed: float) -> None:
    """Ask a camera for its picture, with a login: init, check, serve."""
    sunarc, home = newcomer.sunarc, newcomer.home
    login, address = home / "login", f"127.0.0.1:{free_port()}"
    login.write_text("viewer:of the sky\n")
    newcomer.environment["SUNARC_CAPTURE__CADENCE_S"] = "120.0"
    with ExitStack() as running:
        simulate = ("simulate", "--http", address, "--token-file", str(login), "--truth", str(home / "truth.json"))
        running.enter_context(
            newcomer.runs(sunarc, *simulate, "--speed", str(speed), "--start", "2013-05-13T11:00:00Z")
        )
        while not (home / "truth.json").exists():
            time.sleep(0.5)
        source = ("--url", f"http://{address}/record/current.jpg", "--token-file", str(login))
        newcomer.do(
            sunarc, "init", *SITE, *source, "--state", str(home / "state"), "--port", str(newcomer.port)
        )  # fmt: skip
        serve_until_calibrated(newcomer, running)


def follow_camera(newcomer: Newcomer, speed: float) -> None:
    """Follow a GigE camera at a given address."""
    sunarc, home = newcomer.sunarc, newcomer.home
    with ExitStack() as running:
        simulate = ("simulate", "--address", "127.0.0.1", "--speed", str(speed), "--start", "2013-05-13T11:00:00Z")
        running.enter_context(newcomer.runs(sunarc, *simulate))
        time.sleep(8.0)
        newcomer.environment |= {
            "SUNARC_CAMERA__PACKET_SIZE": "60000",
            "SUNARC_CAMERA__TIMESTAMPS": "camera",
            "SUNARC_CAPTURE__CADENCE_S": "120.0",
            "SUNARC_SENSOR__BLACK_LEVEL_FRACTION": "0.0078",
        }
        newcomer.do(
            sunarc, "init", *SITE, "--camera", "127.0.0.1", "--state", str(home / "state"),
            "--port", str(newcomer.port),
        )  # fmt: skip
        serve_until_calibrated(newcomer, running)


def serve_until_calibrated(newcomer: Newcomer, running: ExitStack) -> None:
    """Check, serve, and wait for the calibration; show what is there after a minute, and at the end."""
    sunarc = newcomer.sunarc
    newcomer.do(sunarc, "check", "--config", "sunarc.toml", codes=(0, 1))
    running.enter_context(newcomer.runs(sunarc, "serve", "--config", "sunarc.toml"))
    newcomer.wait_for("/healthz", what="the service")
    time.sleep(20.0)
    status = newcomer.get("/v1/status")
    print(f"# after the first pictures: {status['health']}, {[one['code'] for one in status['reasons']]}")
    document = newcomer.wait_for("/v1/calibration", what="a served calibration")
    print(f"# {document['id']}: {document['metrics']['rmse_px']:.3f} px RMSE, {document['metrics']['n']} sightings")
    newcomer.do(sunarc, "calibrations", "list", "--config", "sunarc.toml")


def decimal() -> tuple[str, ...]:
    """Return the site as commands other than init take it."""
    return "--latitude", "36.604056", "--longitude", "-97.484861", "--altitude", "318"


if __name__ == "__main__":
    sys.exit(main())
