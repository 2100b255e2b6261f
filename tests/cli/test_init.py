"""`sunarc init`: what is given is written, what is missing is named, what is at hand is tried."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
import threading
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pandas as pd
import pvlib
import pytest
from PIL import Image
from tests.fixtures.rtsp_camera import RtspCamera

from sunarc.common.findings import Finding, FindingError
from sunarc.common.messages import find_message
from sunarc.detection.values import Detection
from sunarc.imager.checks import CheckResult, init_option, run_checks
from sunarc.imager.commands.first_look import TriedPicture, judge_site
from sunarc.imager.runtime.clock import SystemClock
from sunarc.imager.settings.load import load_settings
from sunarc.lab.simulation.made_archive import encoded, photograph
from sunarc.sky.site import Site, parse_angle

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.fixtures.command_line import Answer, Sunarc

SITE = ("--latitude", "36.604043", "--longitude", "-97.484856", "--altitude", "318")
NOON = datetime(2013, 5, 13, 18, tzinfo=UTC)
SIZE = 240


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    """Return a folder as allsky writes it: a folder a day, and a copy of the newest picture."""
    folder = tmp_path / "pictures"
    for hour in range(-5, 6):
        time = NOON + timedelta(hours=hour)
        path = folder / f"{time:%Y%m%d}/image-{time:%Y%m%d%H%M%S}.jpg"
        path.parent.mkdir(parents=True, exist_ok=True)
        sun = np.array([120.0 + 15.0 * hour, 90.0])
        path.write_bytes(encoded(photograph(SIZE, sun, np.random.default_rng(hour + 9))))
    (folder / "image.jpg").write_bytes(path.read_bytes())
    return folder


def init(sunarc: Sunarc, file: Path, *arguments: str) -> Answer:
    return sunarc("init", str(file), "--picture", str(file.parent / "a.png"), *arguments)


def record_of(answer: Answer) -> dict[str, Any]:
    found = json.loads(answer.out)
    assert isinstance(found, dict)
    return found


def codes_in(answer: Answer) -> set[str]:
    return {code for check in record_of(answer)["checks"] for code in check["codes"]}


def test_a_folder_is_looked_at_and_a_file_written_that_the_service_reads(
    sunarc: Sunarc, tmp_path: Path, pictures: Path
) -> None:
    file = tmp_path / "sunarc.toml"
    answer = init(sunarc, file, *SITE, "--folder", str(pictures), "--utc-offset", "0", "--json")
    assert answer.code == 0, answer.err
    settings = load_settings(file)
    assert settings.source == "folder"
    assert settings.folder is not None
    assert settings.folder.path == pictures
    assert settings.site.longitude == -97.484856
    (picture,) = [check for check in record_of(answer)["checks"] if check["what"] == "picture"]
    assert "240x240" in picture["text"]
    assert "2013-05-13 23:00:00" in picture["text"]
    assert "Allsky" in picture["text"]
    assert "site_agrees" in codes_in(answer)
    shown = cv2.imread(str(tmp_path / "a.png"))
    assert shown is not None
    green = (shown[..., 1].astype(int) - shown[..., 2] > 100) & (shown[..., 0] < 60)
    rows, columns = np.nonzero(green)
    assert (columns.mean(), rows.mean()) == pytest.approx((195.0, 90.0), abs=1.0)


def test_pictures_are_looked_at_upright_where_exif_is_to_be_followed(
    sunarc: Sunarc, tmp_path: Path, pictures: Path
) -> None:
    exif = Image.Exif()
    exif[0x0112] = 3
    for path in pictures.rglob("*.jpg"):
        with Image.open(path) as picture:
            picture.copy().save(path, exif=exif, quality=95)
    answer = init(
        sunarc, tmp_path / "a.toml", *SITE, "--folder", str(pictures), "--utc-offset", "0", "--follow-exif", "--json"
    )
    assert answer.code == 0, answer.err
    settings = load_settings(tmp_path / "a.toml")
    assert settings.folder is not None
    assert settings.folder.follow_exif
    (picture,) = [check for check in record_of(answer)["checks"] if check["what"] == "picture"]
    assert f"({SIZE - 1 - 195}, {SIZE - 1 - 90})" in picture["text"]


def test_a_second_run_changes_what_is_given_and_keeps_the_rest(sunarc: Sunarc, tmp_path: Path, pictures: Path) -> None:
    file = tmp_path / "sunarc.toml"
    init(sunarc, file, *SITE, "--folder", str(pictures), "--utc-offset", "0")
    file.write_text(file.read_text() + "\n[disk] # mine\nkeep_days = 3.0 # short\n")
    file.chmod(0o640)
    before = file.read_text()
    answer = init(sunarc, file, "--longitude", "97.484856W", "--json")
    assert answer.code == 0
    assert file.read_text() == before
    assert record_of(answer)["changed"] == {}
    answer = init(sunarc, file, "--altitude", "320", "--port", "9090", "--json")
    assert record_of(answer)["changed"] == {"api.port": 9090, "site.altitude": 320.0}
    changed = [line for line in file.read_text().split("\n") if line not in before.split("\n")]
    assert [line.partition(" ")[0] for line in changed] == ["altitude", "[api]", "port"]
    assert file.stat().st_mode & 0o777 == 0o640


def test_the_packages_file_is_completed_where_its_camera_is_commented_out(
    sunarc: Sunarc, tmp_path: Path, pictures: Path
) -> None:
    file = tmp_path / "sunarc.toml"
    example = (Path(__file__).parents[2] / "deploy/sunarc.toml").read_text().split("\n")
    hidden = ("latitude ", "longitude ", "altitude ", "address ")
    file.write_text("\n".join("# " + line if line.startswith(hidden) else line for line in example))
    answer = init(sunarc, file, *SITE, "--folder", str(pictures), "--utc-offset", "0")
    assert answer.code == 0, answer.err
    assert load_settings(file).camera is None
    assert "what is commented out is the default" in file.read_text().lower()


@pytest.mark.parametrize(
    ("arguments", "code", "field"),
    [
        ((), "answer_missing", "site.latitude"),
        (("--latitude", "97N"), "angle_beyond", "--latitude"),
        (("--latitude", "36E"), "angle_of_other_axis", "--latitude"),
        (("--latitude", "-36S"), "angle_signed_twice", "--latitude"),
        (("--latitude", "36 61 N"), "angle_unreadable", "--latitude"),
        (("--latitude", "36.5 30"), "angle_unreadable", "--latitude"),
        (("--latitude", "36", "--longitude", "8", "--altitude", "high"), "answer_not_number", "--altitude"),
        ((*SITE, "--source", "usb"), "answer_unknown", "--source"),
        ((*SITE, "--source", "folder"), "answer_missing", "folder.path"),
        ((*SITE, "--camera", "127.0.0.1", "--folder", "/srv"), "answer_contradicts", "--folder"),
    ],
)
def test_wrong_input_is_one_line_with_a_code_and_nothing_is_written(
    sunarc: Sunarc, tmp_path: Path, arguments: tuple[str, ...], code: str, field: str
) -> None:
    file = tmp_path / "sunarc.toml"
    answer = init(sunarc, file, *arguments)
    assert answer.code == 2
    assert answer.err.count("\n") == 1
    assert answer.err.startswith(f"sunarc: {field}: ")
    assert answer.err.endswith(f"[{code}]\n")
    assert find_message(code) is not None
    assert not file.exists()


@pytest.mark.parametrize("wrong", ["camera.address", "folder.utc_offset"])
def test_a_value_that_the_service_would_refuse_is_refused(
    sunarc: Sunarc, tmp_path: Path, pictures: Path, wrong: str
) -> None:
    given = {
        "camera.address": ("--camera", "camera.example"),
        "folder.utc_offset": ("--folder", str(pictures), "--utc-offset", "Nowhere/City"),
    }
    file = tmp_path / "sunarc.toml"
    answer = init(sunarc, file, *SITE, *given[wrong])
    assert answer.code == 2
    assert wrong in answer.err
    assert not file.exists()


def test_trials_that_fail_are_exit_code_1_with_their_codes(sunarc: Sunarc, tmp_path: Path, pictures: Path) -> None:
    file = tmp_path / "sunarc.toml"
    answer = init(sunarc, file, *SITE, "--folder", str(tmp_path / "none"), "--json")
    assert (answer.code, codes_in(answer)) == (1, {"folder_missing"})
    answer = init(sunarc, file, "--folder", str(pictures), "--json")
    assert (answer.code, codes_in(answer)) == (1, {"file_time_zone", "site_not_held"})
    assert record_of(answer)["next"].startswith("sunarc init")
    empty = tmp_path / "empty"
    empty.mkdir()
    answer = init(sunarc, file, "--folder", str(empty), "--json")
    assert (answer.code, codes_in(answer)) == (0, {"folder_without_images"})


def test_a_longitude_of_the_wrong_sign_is_named_by_the_suns_of_the_pictures(
    sunarc: Sunarc, tmp_path: Path, pictures: Path
) -> None:
    wrong = ("--latitude", "36.6", "--longitude", "97.48", "--altitude", "318", "--utc-offset", "0")
    answer = init(sunarc, tmp_path / "a.toml", *wrong, "--folder", str(pictures), "--json")
    assert "site_longitude_sign" in codes_in(answer)


@pytest.fixture
def camera(pictures: Path) -> Iterator[str]:
    """Return the address of a folder's files, served as a camera serves its picture."""
    handler = partial(SimpleHTTPRequestHandler, directory=str(pictures))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def test_a_picture_at_an_address_is_asked_for_once_and_shown(sunarc: Sunarc, tmp_path: Path, camera: str) -> None:
    file = tmp_path / "sunarc.toml"
    answer = init(sunarc, file, *SITE, "--url", f"{camera}/image.jpg", "--json")
    assert answer.code == 0, answer.out
    assert load_settings(file).source == "http"
    (picture,) = [check for check in record_of(answer)["checks"] if check["what"] == "picture at http.url"]
    assert "240x240" in picture["text"]
    assert (tmp_path / "a.png").exists()


def test_an_address_without_a_picture_fails_with_its_code(sunarc: Sunarc, tmp_path: Path, camera: str) -> None:
    for path, code in (("none.jpg", "http_status"), ("", "http_no_picture")):
        answer = init(sunarc, tmp_path / "sunarc.toml", *SITE, "--url", f"{camera}/{path}", "--json")
        assert (answer.code, codes_in(answer)) == (1, {code})
    answer = sunarc("check", "--config", str(tmp_path / "sunarc.toml"), "--json")
    assert answer.code == 1
    (failed,) = [check for check in json.loads(answer.out) if check["what"] == "picture at http.url"]
    assert failed["outcome"] == "fail"
    assert "--url" in failed["question"]


def test_a_stream_is_opened_once_and_a_wrong_login_fails_with_its_code(sunarc: Sunarc, tmp_path: Path) -> None:
    file, login = tmp_path / "sunarc.toml", tmp_path / "login"
    login.write_text("owner:secret\n")
    with closing(RtspCamera(login="owner:secret")) as camera:
        camera.image = np.asarray(photograph(SIZE, np.array([120.0, 90.0]), np.random.default_rng(1)))
        answer = init(sunarc, file, *SITE, "--url", camera.url, "--token-file", str(login), "--json")
        assert answer.code == 0, answer.out
        found = load_settings(file)
        assert (found.source, found.rtsp and found.rtsp.token_file) == ("rtsp", login)
        (picture,) = [check for check in record_of(answer)["checks"] if check["what"] == "picture at rtsp.url"]
        assert "240x240" in picture["text"]
        assert (tmp_path / "a.png").exists()
        login.write_text("owner:other\n")
        answer = init(sunarc, file, "--json")
        assert (answer.code, codes_in(answer)) == (1, {"rtsp_denied"})
        assert record_of(answer)["changed"] == {}


def test_on_a_terminal_what_is_missing_is_asked_again_until_it_is_right(tmp_path: Path, pictures: Path) -> None:
    file = tmp_path / "sunarc.toml"
    outer, inner = pty.openpty()
    command = [sys.executable, "-m", "sunarc", "init", str(file), "--folder", str(pictures), "--json"]
    command += ["--picture", str(tmp_path / "a.png"), "--longitude", "-97.484856"]
    with subprocess.Popen(command, stdin=inner, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        os.close(inner)
        os.write(outer, b"north\n36d36m14.6sN\n318\nbackwards\nmirrored\nlevel\n10\n0\n")
        out, err = process.communicate(timeout=60.0)
    os.close(outer)
    assert process.returncode == 0, err
    assert b"[angle_unreadable]" in err
    assert b"[answer_unknown]" in err
    assert json.loads(out)["changed"]["folder.utc_offset"] == "0"
    assert b"[answer_not_number]" in err
    assert load_settings(file).calibration.mirrored == "yes"
    assert load_settings(file).calibration.level_within_deg == 10.0
    assert load_settings(file).site.latitude == pytest.approx(36.604056, abs=1e-6)


def test_every_complaint_of_check_about_what_was_asked_names_the_option(tmp_path: Path, pictures: Path) -> None:
    file = tmp_path / "sunarc.toml"
    file.write_text(
        f'state = "{tmp_path}/state"\nsource = "folder"\n[site]\nlatitude = 1.0\nlongitude = 2.0\n'
        f'[folder]\npath = "{pictures}"\n'
    )
    silent = {"settings", "versions"}
    for result in run_checks(load_settings(file), clock=SystemClock()):
        complaint = result._replace(outcome="fail")
        assert (init_option(complaint) is None) == (result.what in silent), result.what
    assert init_option(CheckResult("port", "ok", "")) is None


def test_a_missing_setting_says_that_init_asks_for_it(sunarc: Sunarc, tmp_path: Path) -> None:
    file = tmp_path / "sunarc.toml"
    file.write_text('[camera]\naddress = "127.0.0.1"\n')
    answer = sunarc("check", "--config", str(file))
    assert answer.code == 2
    assert "sunarc init" in answer.err


# Angles, and sites, against what pvlib's ephemeris says; it shares no code with ours.


@pytest.mark.parametrize(
    ("text", "degrees"),
    [
        ("-97.5", -97.5),
        ("97.5W", -97.5),
        ("W 97.5", -97.5),
        ("97,5", 97.5),
        ("97°30'W", -97.5),
        ("97°30′00″ W", -97.5),
        ("97 30 0 w", -97.5),
        ("97d29m60.0s", None),
        ("0", 0.0),
        ("180", 180.0),
        ("180.1", None),
        ("1e2", None),
        ("nan", None),
    ],
)
def test_angles_are_read_as_they_are_written(text: str, degrees: float | None) -> None:
    if degrees is None:
        with pytest.raises(FindingError):
            parse_angle(text, question="--longitude", axis="EW")
    else:
        assert parse_angle(text, question="--longitude", axis="EW") == degrees


def seen_suns(rng: np.random.Generator, latitude: float, longitude: float) -> list[TriedPicture]:
    start = 1.4e9 + rng.uniform(0.0, 3e8)
    times = start + rng.uniform(0.0, 86_400.0 * rng.choice([0.3, 1.0, 60.0]), 60)
    index = pd.to_datetime(times, unit="s", utc=True)
    zenith = pvlib.solarposition.get_solarposition(index, latitude, longitude)["apparent_zenith"].to_numpy()
    sun = Detection(method="paper", accepted=True, verdict="clear", findings=())
    up = times[zenith < 88.0][: rng.integers(1, 17)]
    return [TriedPicture(name="", time=datetime.fromtimestamp(time, UTC), found=sun) for time in up]


def test_a_right_site_is_never_doubted_and_a_wrong_one_never_given_another_slip() -> None:
    rng = np.random.default_rng(20)
    found: dict[str, list[str]] = {"right": [], "site_longitude_sign": [], "site_latitude_sign": [], "site_swapped": []}
    for _ in range(120):
        site = Site(latitude=float(rng.uniform(-60.0, 65.0)), longitude=float(rng.uniform(-90.0, 90.0)))
        pictures = seen_suns(rng, site.latitude, site.longitude)
        if pictures:
            found["right"].append(judge_site(pictures, site).code)
            slips = {
                "site_longitude_sign": replace(site, longitude=-site.longitude),
                "site_latitude_sign": replace(site, latitude=-site.latitude),
                "site_swapped": replace(site, latitude=site.longitude, longitude=site.latitude),
            }
            for slip, wrong in slips.items():
                found[slip].append(judge_site(pictures, wrong).code)
    assert set(found.pop("right")) == {"site_agrees"}
    for slip, codes in found.items():
        assert {code for code in codes if code.startswith("site_") and code in found} <= {slip}
        assert codes.count(slip) > 0.02 * len(codes)


def test_one_light_at_night_names_no_slip() -> None:
    light = Detection(method="paper", accepted=True, verdict="clear", findings=())
    moon = TriedPicture(name="", time=NOON + timedelta(hours=12), found=light)
    noon = replace(moon, time=NOON)
    site = Site(latitude=36.6, longitude=-97.5)
    assert judge_site([moon, noon, noon, noon], site).code == "site_sun_down_in_some"
    assert judge_site([moon], site).code == "site_sun_down"
    assert judge_site([replace(moon, found=None)], site) == Finding("site_not_held")


@pytest.mark.parametrize(("host", "zone"), [("Pacific/Auckland", "Pacific/Auckland"), ("EST5EDT4,M3.2.0", "UTC")])
def test_the_time_zone_is_the_hosts_and_never_that_of_the_longitude(
    sunarc: Sunarc, pictures: Path, monkeypatch: pytest.MonkeyPatch, host: str, zone: str
) -> None:
    monkeypatch.setenv("TZ", host)
    file = pictures.parent / "sunarc.toml"
    assert init(sunarc, file, *SITE, "--folder", str(pictures), "--utc-offset", "0").code == 0
    assert load_settings(file).site.timezone == zone


def test_the_time_zone_that_is_given_is_kept_and_one_that_does_not_exist_leaves_the_file_alone(
    sunarc: Sunarc, tmp_path: Path, pictures: Path
) -> None:
    file = tmp_path / "sunarc.toml"
    init(sunarc, file, *SITE, "--folder", str(pictures), "--utc-offset", "0", "--timezone", "America/Chicago")
    before = file.read_text()
    answer = init(sunarc, file, "--timezone", "Mars/Olympus")
    assert answer.code == 2
    assert "site.timezone" in answer.err
    assert init(sunarc, file, "--altitude", "318").code == 0
    assert file.read_text() == before
    assert load_settings(file).site.timezone == "America/Chicago"
