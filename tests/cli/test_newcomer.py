"""What a newcomer has: a settings file, a file of sightings, and no database."""

from __future__ import annotations

import json
import threading
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from sunarc.calibration.model.options import CalibrationOptions
from sunarc.common.errors import InputError
from sunarc.imager.app.cameras import require_stored_site
from sunarc.imager.archive.archive import Archive, CameraArchive, open_archive
from sunarc.imager.archive.database.state_folder import lock_state
from sunarc.imager.archive.values import Refit
from sunarc.imager.checks import run_checks
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.settings.load import load_settings
from sunarc.imager.workers.calibrating.refit import RefitWorker
from sunarc.imager.workers.options import RefitOptions
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_angles, sun_directions

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

CONFIG = (
    'name = "roof"\nstate = "{state}"\n[site]\nlatitude = 36.604043\nlongitude = -97.484856\naltitude = 318.0\n'
    "[calibration]\nlevel_within_deg = 40.0\n"
)
DAY = datetime(2013, 5, 13, 6, tzinfo=UTC).timestamp()
NOW = datetime(2013, 5, 15, tzinfo=UTC)
BYTE_ORDER_MARK = "\ufeff"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "sunarc.toml"
    path.write_text(CONFIG.format(state=tmp_path / "state"))
    return path


@pytest.fixture
def points(tmp_path: Path) -> Path:
    """Return a clear day of sightings, every 5 minutes."""
    times = DAY + np.arange(0.0, 86_400.0, 300.0)
    times = times[sun_angles(times, SGP).apparent_zenith < 85.0]
    pixels = project(true_camera(), sun_directions(times, SGP))
    pixels += np.random.default_rng(1).normal(0.0, 0.02, pixels.shape)
    rows = [
        f"{datetime.fromtimestamp(t, UTC).isoformat().replace('+00:00', 'Z')},{x:.4f},{y:.4f}"
        for t, (x, y) in zip(times.tolist(), pixels.tolist(), strict=True)
    ]
    path = tmp_path / "points.csv"
    path.write_text("\n".join(["time_utc,x_px,y_px", *rows, ""]))
    return path


def imported(sunarc: Sunarc, config: Path, points: Path, *more: str) -> str:
    answer = sunarc("points", "import", str(points), "--config", str(config), *more)
    assert answer.code == 0, answer.err
    return answer.out


def refit(archive: Archive) -> Refit:
    """Carry a refit out as the service does."""
    clock = VirtualClock(NOW)
    board = StatusRegistry(version="test", started_at=NOW, monotonic=clock.monotonic)
    worker = RefitWorker(
        camera=CameraArchive(archive, name="roof", site=SGP), options=RefitOptions(),
        calibration=CalibrationOptions(level_within_deg=40.0), cadence_s=300.0, clock=clock, now=clock.now, board=board,
    )  # fmt: skip
    asked = archive.refits.add(Refit(id="r", camera="roof", requested_at=NOW, reason="imported"))
    worker.carry_out(asked, threading.Event(), lambda: None)
    return archive.refits.get("r")


def test_an_import_into_a_new_folder_names_once_what_it_needs_and_then_a_refit_calibrates(
    sunarc: Sunarc, config: Path, points: Path
) -> None:
    refused = sunarc("points", "import", str(points), "--config", str(config))
    assert refused.code == 2
    assert "--image-size 1748,1748" in refused.err
    assert refused.err.count("\n") == 1
    assert not (config.parent / "state").exists()  # nothing half done
    assert "sightings added" in imported(sunarc, config, points, "--image-size", "1748,1748")
    assert imported(sunarc, config, points).startswith("0 of ")  # now the archive knows the size
    archive = open_archive(config.parent / "state" / "sunarc.sqlite")
    (camera,) = archive.cameras.all()
    assert (camera.name, camera.latitude, camera.width, camera.height) == ("roof", 36.604043, 1748, 1748)
    done = refit(archive)
    assert done.state == "accepted", done.message
    served = archive.calibrations.current("roof")
    archive.close()
    assert served is not None
    assert served.document["metrics"]["rmse_px"] < 0.1


def test_the_size_may_come_from_the_settings(sunarc: Sunarc, config: Path, points: Path) -> None:
    with config.open("a") as file:
        file.write('[camera]\naddress = "127.0.0.9"\nregion = [0, 0, 1748, 1748]\n')
    assert "sightings added" in imported(sunarc, config, points)


def test_another_size_than_the_archives_is_refused(sunarc: Sunarc, config: Path, points: Path) -> None:
    imported(sunarc, config, points, "--image-size", "1748,1748")
    answer = sunarc("points", "import", str(points), "--config", str(config), "--image-size", "2000,2000")
    assert (answer.code, "2000x2000 px, and camera 'roof' makes 1748x1748" in answer.err) == (2, True)
    assert sunarc("points", "import", str(points), "--config", str(config), "--image-size", "0,5").code == 2


def test_a_file_that_windows_wrote_is_read(sunarc: Sunarc, config: Path, points: Path) -> None:
    for path in (config, points):
        text = BYTE_ORDER_MARK + path.read_text().replace("\n", "\r\n")
        path.write_bytes(text.encode())
    points.write_bytes(points.read_bytes().replace(b"time_utc", b'"time_utc"', 1))
    assert load_settings(config).name == "roof"
    assert "sightings added" in imported(sunarc, config, points, "--image-size", "1748,1748")


@pytest.mark.parametrize("which", ["settings", "points"])
def test_a_file_in_utf_16_is_refused_in_one_line(sunarc: Sunarc, config: Path, points: Path, which: str) -> None:
    path = config if which == "settings" else points
    path.write_bytes(path.read_text().encode("utf-16"))
    answer = sunarc("points", "import", str(points), "--config", str(config), "--image-size", "1748,1748")
    assert (answer.code, answer.err.count("\n"), "UTF-8" in answer.err) == (2, 1, True)


@pytest.mark.parametrize(("latitude", "refused"), [(36.608, False), (36.610, True), (48.1, True)])
def test_an_archive_from_another_site_is_refused(
    sunarc: Sunarc, config: Path, points: Path, *, latitude: float, refused: bool
) -> None:
    imported(sunarc, config, points, "--image-size", "1748,1748")
    config.write_text(config.read_text().replace("36.604043", str(latitude)))
    answer = sunarc("points", "import", str(points), "--config", str(config))
    assert (answer.code, "set `name` to a new one" in answer.err) == ((2, True) if refused else (0, False))
    archive = open_archive(config.parent / "state" / "sunarc.sqlite")
    settings = load_settings(config)
    if refused:
        with pytest.raises(InputError, check=lambda error: error.field == "site"):
            require_stored_site(archive, settings)
    else:
        require_stored_site(archive, settings)
    archive.close()


def test_an_import_beside_a_running_service_says_when_it_counts(sunarc: Sunarc, config: Path, points: Path) -> None:
    imported(sunarc, config, points, "--image-size", "1748,1748")
    with lock_state(config.parent / "state"):
        answer = sunarc("points", "import", str(points), "--config", str(config))
    assert answer.code == 0
    assert "uses this state folder; its next refit takes the new sightings" in answer.err


def test_the_check_of_a_new_database_says_what_is_damaged(sunarc: Sunarc, config: Path, points: Path) -> None:
    imported(sunarc, config, points, "--image-size", "1748,1748")
    found = json.loads(sunarc("db", "check", "--state", str(config.parent / "state"), "--json").out)
    assert (found["sound"], found["damaged_calibrations"]) == (True, [])


def test_the_check_says_that_a_lost_database_is_restored_and_that_the_site_is_another(
    sunarc: Sunarc, config: Path, points: Path
) -> None:
    state = config.parent / "state"
    imported(sunarc, config, points, "--image-size", "1748,1748")
    backups = str(state / "backups")
    assert sunarc("db", "backup", backups, "--keep", "3", "--state", str(state)).code == 0
    elsewhere = config.with_name("elsewhere.toml")
    elsewhere.write_text(config.read_text().replace("36.604043", "48.1"))
    clock = VirtualClock(NOW)
    (other,) = [found for found in run_checks(load_settings(elsewhere), clock=clock) if found.what == "database"]
    assert (other.outcome, "set `name` to a new one" in other.text) == ("fail", True)
    (state / "sunarc.sqlite").write_bytes(b"")
    (lost,) = [found for found in run_checks(load_settings(config), clock=clock) if found.what == "database"]
    assert (lost.outcome, "restores it from" in lost.text) == ("warn", True)
    refused = sunarc("points", "import", str(points), "--config", str(config), "--image-size", "1748,1748")
    assert (refused.code, "sunarc db restore --latest" in refused.err) == (2, True)
