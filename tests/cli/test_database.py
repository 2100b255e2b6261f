from __future__ import annotations

import json
import os
from datetime import UTC, date, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import xarray as xr
from tests.fixtures.postgresql import postgresql

from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.database.state_folder import lock_state
from sunarc.imager.archive.values import CameraRecord, DayAir

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc
    from tests.fixtures.postgresql import Server

__all__ = ["postgresql"]

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
POINTS = (
    "time_utc,x_px,y_px,sigma_px,body\n2013-05-13T18:30:00Z,871.5,883.25,0.01,sun\n2013-05-13T18:31:00Z,870,880,,sun\n"
)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "sunarc.toml"
    path.write_text(f'name = "roof"\nstate = "{tmp_path}/state"\n[site]\nlatitude = 36.6\nlongitude = -97.5\n')
    return path


@pytest.fixture
def with_camera(sunarc: Sunarc, config: Path) -> Path:
    state = config.parent / "state"
    assert sunarc("db", "upgrade", "--state", str(state)).code == 0
    archive = open_archive(state / "sunarc.sqlite")
    archive.cameras.save(
        CameraRecord(name="roof", latitude=36.6, longitude=-97.5, altitude=0.0, width=1748, height=1748)
    )
    archive.close()
    return config


def test_a_database_is_made_checked_and_copied(sunarc: Sunarc, tmp_path: Path) -> None:
    state = str(tmp_path / "state")
    assert sunarc("db", "upgrade", "--state", state).code == 0
    assert "up to date" in sunarc("db", "upgrade", "--state", state).out
    checked = sunarc("db", "check", "--state", state, "--json")
    assert checked.code == 0
    assert json.loads(checked.out)["sound"] is True
    copy = tmp_path / "copy.sqlite"
    assert sunarc("db", "backup", str(copy), "--state", state).code == 0
    assert copy.stat().st_size > 0


def test_a_database_that_is_missing_is_refused_with_the_command_to_run(sunarc: Sunarc, config: Path) -> None:
    answer = sunarc("points", "export", "--config", str(config))
    assert answer.code == 2
    assert f"sunarc db upgrade --state {config.parent}/state" in answer.err


def test_imported_sightings_come_out_again_and_are_not_doubled(sunarc: Sunarc, with_camera: Path) -> None:
    file = with_camera.parent / "points.csv"
    file.write_text(POINTS)
    first = sunarc("points", "import", str(file), "--config", str(with_camera))
    assert "2 of 2 sightings added" in first.out
    second = sunarc("points", "import", str(file), "--config", str(with_camera))
    assert "0 of 2 sightings added, 2 were there already" in second.out
    exported = sunarc("points", "export", "--config", str(with_camera)).out.splitlines()
    assert exported[1:] == [
        "2013-05-13T18:30:00.000000Z,871.500000,883.250000,0.010000,sun",
        "2013-05-13T18:31:00.000000Z,870.000000,880.000000,,sun",
    ]
    since = sunarc("points", "export", "--config", str(with_camera), "--since", "2013-05-13T18:31:00Z")
    assert len(since.out.splitlines()) == 2


def test_sightings_of_stated_directions_are_not_imported(sunarc: Sunarc, with_camera: Path, tmp_path: Path) -> None:
    points = tmp_path / "stars.csv"
    points.write_text("time_utc,x_px,y_px,zenith_deg,azimuth_deg\n2013-05-13T06:00:00Z,10,20,30,90\n")
    refused = sunarc("points", "import", str(points), "--config", str(with_camera))
    assert refused.code == 2
    assert "stars.csv, body" in refused.err


def test_the_air_of_imported_sightings_comes_out_again(sunarc: Sunarc, with_camera: Path) -> None:
    rows = (
        "2013-05-13T18:30:00.000000Z,871.500000,883.250000,0.010000,sun,35.250,975.300",
        "2013-05-13T18:31:00.000000Z,870.000000,880.000000,,sun,20.000,",
        "2013-05-14T18:31:00.000000Z,870.000000,880.000000,,sun,,",
    )
    file = with_camera.parent / "points.csv"
    file.write_text("\n".join(("time_utc,x_px,y_px,sigma_px,body,temperature_c,pressure_hpa", *rows)))
    assert sunarc("points", "import", str(file), "--config", str(with_camera)).code == 0
    assert sunarc("points", "export", "--config", str(with_camera)).out.splitlines()[1:] == list(rows)
    archive = open_archive(with_camera.parent / "state" / "sunarc.sqlite")
    day = DayAir(camera="roof", date=date(2013, 5, 13), temperature_c=30.0, pressure_hpa=980.0, set_at=NOON)
    archive.days.set_air(day)
    archive.close()
    exported = sunarc("points", "export", "--config", str(with_camera)).out.splitlines()
    assert exported[1:] == [rows[0], f"{rows[1]}980.000", rows[2]], "the day's air stands where a sighting has none"


def test_a_bad_row_changes_nothing(sunarc: Sunarc, with_camera: Path) -> None:
    file = with_camera.parent / "points.csv"
    file.write_text(POINTS + "2013-05-13T18:32:00Z,99999,880,,sun\n")
    answer = sunarc("points", "import", str(file), "--config", str(with_camera))
    assert answer.code == 2
    assert "pixel (99999, 880) is outside the 1748x1748 image" in answer.err
    assert sunarc("points", "export", "--config", str(with_camera)).out.count("\n") == 1


def test_the_history_is_listed_rolled_back_and_pinned(sunarc: Sunarc, with_camera: Path) -> None:
    archive = open_archive(with_camera.parent / "state" / "sunarc.sqlite")
    archive.epochs.at("roof", datetime(2013, 5, 1, tzinfo=UTC), reason="installed")
    for day, name in enumerate(("first", "second"), start=1):
        moment = f"2013-05-{day:02d}T06:00:00Z"
        verdict = {"accepted": True, "reasons": ["fits"]}
        known = {"id": name, "camera": "roof", "method": "robust", "pose_epoch": "roof-1", "verdict": verdict}
        archive.calibrations.add({**known, "created_at": moment, "valid_from": moment})
        archive.calibrations.activate(name)
    archive.close()
    said = ("--config", str(with_camera))
    back = sunarc("calibrations", "activate", "first", "--from", "2013-05-03T00:00:00Z", "--reason", "sharper", *said)
    assert {"first-r1", "2013-05-03T00:00:00+00:00"} <= set(back.out.split())
    assert sunarc("calibrations", "pin", "first-r1", *said).code == 0
    rows = json.loads(sunarc("calibrations", "list", "--json", *said).out)
    assert [(row["id"], row["state"], row["pinned"]) for row in rows] == [
        ("first-r1", "current", True),
        ("second", "retired", False),
        ("first", "retired", False),
    ]
    assert "│ pinned" in sunarc("calibrations", "list", *said).out
    assert "first-r1" in sunarc("calibrations", "unpin", "first-r1", *said).out
    unknown = sunarc("calibrations", "activate", "third", *said)
    assert (unknown.code, "third" in unknown.err) == (2, True)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written_to_is_one_line_and_exit_3(sunarc: Sunarc, tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    answer = sunarc("db", "upgrade", "--state", str(tmp_path / "state"))
    assert answer.code == 3
    assert answer.err.count("\n") == 1


def test_everything_is_written_as_files_that_other_tools_read(
    sunarc: Sunarc, with_camera: Path, tmp_path: Path
) -> None:
    points = tmp_path / "points.csv"
    points.write_text(POINTS)
    assert sunarc("points", "import", str(points), "--config", str(with_camera)).code == 0
    state, folder = str(tmp_path / "state"), tmp_path / "everything"
    answer = sunarc("db", "export", str(folder), "--state", state, "--json")
    assert answer.code == 0
    assert json.loads(answer.out)["sun_points.csv"] == 2
    rows = (folder / "sun_points.csv").read_text().splitlines()
    assert rows[1].split(",")[rows[0].split(",").index("x_px")] == "871.5"
    with xr.open_dataset(folder / "sun_points.nc", engine="h5netcdf") as sightings:
        assert str(sightings.time.values[0]) == "2013-05-13T18:30:00.000000000"
        assert sightings.x_px.values.tolist() == [871.5, 870.0]
        assert sightings.x_px.units == "px"
    again = sunarc("db", "export", str(folder), "--state", state)
    assert again.code == 2
    assert "is not empty" in again.err


def test_a_copy_is_restored_and_a_missing_one_refused(sunarc: Sunarc, with_camera: Path, tmp_path: Path) -> None:
    state = str(tmp_path / "state")
    assert with_camera.exists()
    assert sunarc("db", "backup", str(tmp_path / "copies"), "--keep", "3", "--state", state).code == 0
    (copy,) = (tmp_path / "copies").iterdir()
    assert "the former one is kept" in sunarc("db", "restore", str(copy), "--state", state).out
    assert sunarc("db", "check", "--state", state).code == 0
    assert sunarc("db", "restore", str(tmp_path / "none"), "--state", state).code == 2
    assert sunarc("db", "downgrade", "--to", "7", "--state", state).code == 2


def test_the_newest_copy_is_restored_by_one_word(sunarc: Sunarc, with_camera: Path, tmp_path: Path) -> None:
    state = tmp_path / "state"
    said = ("--state", str(state))
    assert with_camera.exists()
    nothing = sunarc("db", "restore", "--latest", *said)
    assert (nothing.code, "no sound copy is in" in nothing.err) == (2, True)
    assert sunarc("db", "backup", str(state / "backups"), "--keep", "3", *said).code == 0
    (state / "sunarc.sqlite").write_bytes(b"")
    assert "sunarc.sqlite is what" in sunarc("db", "restore", "--latest", *said).out
    assert sunarc("db", "check", *said).code == 0
    both = sunarc("db", "restore", str(tmp_path / "copy"), "--latest", *said)
    neither = sunarc("db", "restore", *said)
    assert (both.code, neither.code) == (2, 2)


@pytest.mark.parametrize("command", [("restore", "--latest"), ("upgrade",), ("downgrade", "--to", "0001")])
def test_the_database_of_a_running_service_is_not_replaced_or_migrated(
    sunarc: Sunarc, with_camera: Path, tmp_path: Path, command: tuple[str, ...]
) -> None:
    state = tmp_path / "state"
    assert with_camera.exists()
    assert sunarc("db", "backup", str(state / "backups"), "--keep", "3", "--state", str(state)).code == 0
    with lock_state(state):
        refused = sunarc("db", *command, "--state", str(state))
        assert refused.code == 3
        assert f"in use by process {os.getpid()}; stop that service first" in refused.err
        assert sunarc("db", "check", "--state", str(state)).code == 0  # what only reads goes on


def test_a_server_is_upgraded_and_checked_by_its_address(sunarc: Sunarc, postgresql: Server) -> None:
    url = postgresql.new_database(template="template0")
    store = url.render_as_string(hide_password=False)
    assert sunarc("db", "check", "--store", store).code == 1
    for words in ("was upgraded", "is up to date"):
        done = sunarc("db", "upgrade", "--store", store)
        assert done.code == 0
        assert words in done.out
    found = json.loads(sunarc("db", "check", "--store", store, "--json").out)
    assert found["sound"]
    assert found["rows"]["sun_point"] == 0
    postgresql.drop(url)


@pytest.mark.parametrize("options", [[], ["--state", "s", "--store", "postgresql://h/d"], ["--store", "sqlite:///x"]])
def test_one_database_is_named(sunarc: Sunarc, options: list[str]) -> None:
    for command in ("upgrade", "check"):
        assert sunarc("db", command, *options).code == 2


def test_commands_work_on_the_store_of_the_settings(
    sunarc: Sunarc, config: Path, postgresql: Server, tmp_path: Path
) -> None:
    url = postgresql.new_database()
    address = url.render_as_string(hide_password=False)
    config.write_text(f'store = "{address}"\n{config.read_text()}')
    (tmp_path / "points.csv").write_text(POINTS)
    options = ("--config", str(config))
    done = sunarc("points", "import", str(tmp_path / "points.csv"), "--image-size", "1748,1748", *options)
    assert (done.code, done.out.split(" ")[0]) == (0, "2")
    assert len(sunarc("points", "export", *options).out.splitlines()) == 3
    assert sunarc("calibrations", "list", *options).code == 0
    assert not (tmp_path / "state" / "sunarc.sqlite").exists()
    postgresql.drop(url)
