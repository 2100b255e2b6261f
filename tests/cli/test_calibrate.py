from __future__ import annotations

import csv
import json
import math
import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from sunarc.formats.csv_files import write_sightings
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles
from sunarc.public.summary import field_text
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

REAL = Path(__file__).parents[3] / "shared" / "real" / "fe4_2016-08-30.csv"
SITE = Site(latitude=36.604043, longitude=-97.484856, altitude=318.0)
AT_SGP = ("--latitude", "36.604043", "--longitude", "-97.484856", "--altitude", "318", "--image-size", "1748,1748")
CAMERA = Camera(
    width=1748,
    height=1748,
    projection="equisolid",
    focal_length_px=(601.32, 601.32),
    principal_point_px=(871.96, 883.0),
    rotation_cam_enu=rotation_from_pose_angles(PoseAngles(47.91, 2.46, 140.16)),
)


def write_day(path: Path, camera: Camera) -> Path:
    """Write a clear day of sightings, one every four minutes, with 0.02 px of noise."""
    times = datetime(2013, 5, 13, 6, tzinfo=UTC).timestamp() + np.arange(0.0, 86_400.0, 240.0)
    times = times[sun_angles(times, SITE).apparent_zenith < 88.0]
    pixels = project(camera, sun_directions(times, SITE)) + np.random.default_rng(1).normal(0.0, 0.02, (times.size, 2))
    with path.open("w") as file:
        write_sightings(
            file,
            [
                (datetime.fromtimestamp(t, UTC), x, y, 0.02, "sun")
                for t, (x, y) in zip(times.tolist(), pixels.tolist(), strict=True)
            ],
        )
    return path


@pytest.fixture
def points(tmp_path: Path) -> Path:
    return write_day(tmp_path / "points.csv", CAMERA)


def test_a_clear_day_is_accepted_and_its_document_answers_for_pixels_and_directions(
    sunarc: Sunarc, points: Path, tmp_path: Path
) -> None:
    answer = sunarc("calibrate", str(points), *AT_SGP, "--json")
    assert answer.code == 0, answer.err
    document = json.loads(answer.out)
    assert document["schema"] == "sunarc.calibration/2"
    assert document["metrics"]["rmse_px"] < 0.05
    file = tmp_path / "calibration.json"
    file.write_text(answer.out)
    placed = sunarc("project", "--calibration", str(file), stdin="zenith_deg,azimuth_deg\n40,135\n170,10\n")
    rows = placed.out.splitlines()
    assert rows[0] == "x_px,y_px,sigma_px,cov_xx,cov_xy,cov_yy,inside"
    assert rows[2] == ",,,,,,0"
    x, y, sigma, *_, inside = rows[1].split(",")
    assert inside == "1"
    back = sunarc("unproject", "--calibration", str(file), stdin=f"x_px,y_px\n{x},{y}\n-500,-500\n")
    header, found, outside = back.out.splitlines()
    assert header == "zenith_deg,azimuth_deg,sigma_deg,inside"
    zenith, azimuth, sigma_deg, inside = found.split(",")
    assert float(zenith) == pytest.approx(40.0, abs=1e-7)
    assert float(azimuth) == pytest.approx(135.0, abs=1e-7)
    assert inside == "1"
    assert 0.0 < float(sigma_deg) < 0.1
    assert 0.0 < float(sigma) < 1.0
    assert outside.endswith(",0")


def test_a_readable_summary_is_printed_without_json(sunarc: Sunarc, points: Path) -> None:
    answer = sunarc("calibrate", str(points), *AT_SGP)
    assert answer.code == 0
    assert "equisolid" in answer.out
    assert "accepted" in answer.out
    assert re.search(r"\npose +image top points to azimuth 13\d°, tilted 2\.\d° to the south-east\n", answer.out)


def test_a_record_that_stands_still_is_refused_in_a_readable_table(sunarc: Sunarc, tmp_path: Path) -> None:
    rows = [f"2013-05-13T{hour}:{minute}:00Z,1700.0,40.0" for hour in range(15, 23) for minute in range(10, 60, 10)]
    still = tmp_path / "still.csv"
    still.write_text("\n".join(["time_utc,x_px,y_px", *rows]) + "\n", encoding="utf-8")
    answer = sunarc("calibrate", str(still), *AT_SGP)
    assert answer.code == 1
    assert "do not move" in answer.out
    assert "no fit" in answer.out


def test_a_refused_fit_exits_1_and_still_prints_its_document(sunarc: Sunarc, points: Path) -> None:
    lines = points.read_text().splitlines()
    points.write_text("\n".join(lines[:4]))
    answer = sunarc("calibrate", str(points), *AT_SGP, "--json")
    assert answer.code == 1
    verdict = json.loads(answer.out)["verdict"]
    assert not verdict["accepted"]
    assert verdict["reasons"]


def test_few_suns_of_a_morning_are_kept_where_they_are_sure(sunarc: Sunarc, tmp_path: Path) -> None:
    file = write_day(tmp_path / "morning.csv", CAMERA)
    rows = file.read_text(encoding="utf-8").splitlines()
    head, morning = rows[0], rows[20:42]
    file.write_text("\n".join([head, *(row.replace(",0.02,", ",0.5,") for row in morning)]) + "\n", encoding="utf-8")
    refused = sunarc("calibrate", str(file), *AT_SGP)
    assert refused.code == 1
    kept = sunarc("calibrate", str(file), *AT_SGP, "--provisional", "--json")
    assert kept.code == 0, kept.err
    document = json.loads(kept.out)
    assert (document["state"], document["verdict"]["accepted"], document["verdict"]["marginal"]) == (
        "candidate",
        False,
        True,
    )
    assert document["verdict"]["findings"][0]["code"] == "provisional_where_sure"
    assert document["uncertainty"]["sigma_limit_deg"] == 1.5
    calibration = tmp_path / "provisional.json"
    calibration.write_text(kept.out, encoding="utf-8")
    compared = sunarc("compare", str(calibration), str(calibration), "--json")
    assert json.loads(compared.out)["sigma_limits_deg"] == [1.5, 1.5]


@pytest.mark.real
@pytest.mark.skipif(not REAL.exists(), reason="the real sun tracks are not beside the repository")
def test_real_detections_of_a_consumer_fisheye_fit_to_less_than_a_pixel(sunarc: Sunarc) -> None:
    place = ("--latitude", "54.495866", "--longitude", "11.237683", "--altitude", "9")
    answer = sunarc(
        "calibrate", str(REAL), *place, "--image-size", "1920,1920", "--projection", "equidistant", "--json"
    )
    document = json.loads(answer.out)
    metrics = document["metrics"]
    assert document["evidence"]["moves"] == []
    assert metrics["rmse_px"] <= 0.95
    assert math.isfinite(metrics["rmse_all_px"])


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("--image-size", "big"), "--image-size: 'big' is not W,H"),
        (("--projection", "mercator"), "--projection: 'mercator' is unknown"),
        (("--latitude", "136"), "--latitude: '136' is beyond 90 degrees"),
        (("--mirrored", "perhaps"), "--mirrored: 'perhaps' is unknown"),
        (("--mirrored", "yes", "--mirrored", "no"), "--mirrored: given twice: yes, no"),
        (("--projection", "equisolid", "--projection", "equidistant"), "--projection: given twice"),
        (("--image-size", "500,500"), "is outside the 500x500 image"),
    ],
)
def test_a_wrong_option_is_one_line_and_exit_2(
    sunarc: Sunarc, points: Path, change: tuple[str, ...], told: str
) -> None:
    answer = sunarc("calibrate", str(points), *AT_SGP, *change)
    assert answer.code == 2
    assert told in answer.err
    assert answer.err.count("\n") == 1


@pytest.mark.parametrize("circle", ["874,874,850", "image"])
def test_an_image_circle_is_taken_as_numbers_or_from_a_daytime_image(
    sunarc: Sunarc, points: Path, tmp_path: Path, circle: str
) -> None:
    if circle == "image":
        circle = str(tmp_path / "noon.png")
        rows, columns = np.mgrid[:1748, :1748]
        inside = np.hypot(columns - 874.0, rows - 874.0) < 850.0
        cv2.imwrite(circle, np.where(inside, 160, 4).astype(np.uint8))
    answer = sunarc("calibrate", str(points), *AT_SGP, "--image-circle", circle, "--json")
    assert answer.code == 0, answer.err
    assert json.loads(answer.out)["metrics"]["rmse_px"] < 0.05


def test_an_image_without_a_circle_is_one_line_and_exit_2(sunarc: Sunarc, points: Path, tmp_path: Path) -> None:
    plain = tmp_path / "plain.png"
    cv2.imwrite(str(plain), np.zeros((400, 400), dtype=np.uint8))
    answer = sunarc("calibrate", str(points), *AT_SGP, "--image-circle", str(plain))
    assert answer.code == 2
    assert "shows no image circle" in answer.err


def test_after_a_move_the_lens_can_be_kept_and_the_pose_alone_fitted(
    sunarc: Sunarc, points: Path, tmp_path: Path
) -> None:
    before, moved = tmp_path / "before.json", tmp_path / "moved.csv"
    before.write_text(sunarc("calibrate", str(points), *AT_SGP, "--json").out)
    write_day(moved, replace(CAMERA, rotation_cam_enu=rotation_from_pose_angles(PoseAngles(20.0, 4.0, 30.0))))
    kept = sunarc("calibrate", str(moved), *AT_SGP, "--start", str(before), "--pose-only", "--json")
    assert kept.code == 0, kept.err
    document, lens = json.loads(kept.out), json.loads(before.read_text())["model"]
    assert document["model"]["focal_length_px"] == pytest.approx(lens["focal_length_px"], abs=0.5)
    assert document["pose"]["phi_xz_deg"] == pytest.approx(20.0, abs=0.05)
    assert document["metrics"]["rmse_px"] < 0.1
    assert document["evidence"]["options"]["free"] == "pose"
    assert sunarc("calibrate", str(moved), *AT_SGP, "--pose-only").code == 2


def test_a_camera_of_another_program_is_a_prior_for_few_sightings(sunarc: Sunarc, points: Path, tmp_path: Path) -> None:
    document, start = tmp_path / "document.json", tmp_path / "camera.cameramodel"
    document.write_text(sunarc("calibrate", str(points), *AT_SGP, "--json").out)
    assert sunarc("export", "--calibration", str(document), "--format", "mrcal", "-o", str(start)).code == 0
    few = tmp_path / "few.csv"
    few.write_text("".join(points.read_text().splitlines(keepends=True)[:6]))
    named = ("calibrate", str(few), *AT_SGP, "--start", str(start))
    found = sunarc(*named, "--lens-within", "0.5", "--pose-within", "0.1", "--json")
    assert found.code == 0, found.err
    assert json.loads(found.out)["evidence"]["options"]["prior"]["lens_px"] == 0.5
    assert sunarc(*named, "--json").code == 1  # five sightings are too few without the prior
    assert sunarc(*named, "--pose-within", "0.1").code == 2
    assert sunarc("calibrate", str(few), *AT_SGP, "--lens-within", "0.5").code == 2


def test_a_malformed_row_is_named_by_its_line(sunarc: Sunarc, points: Path) -> None:
    points.write_text(points.read_text() + "2013-05-14T18:30:00Z,oops,3,0.02,sun\n")
    answer = sunarc("calibrate", str(points), *AT_SGP)
    assert answer.code == 2
    assert "x_px: 'oops' is not a finite number" in answer.err


def test_a_document_that_is_none_is_one_line_and_exit_2(sunarc: Sunarc, tmp_path: Path) -> None:
    file = tmp_path / "calibration.json"
    for text in ("{", "{}", '{"schema": "other/1"}'):
        file.write_text(text)
        answer = sunarc("project", "--calibration", str(file), stdin="zenith_deg,azimuth_deg\n1,2\n")
        assert answer.code == 2
        assert answer.err.count("\n") == 1


@pytest.mark.parametrize(
    ("amplitude", "mean", "said"),
    [
        (0.0, [[], []], "none"),
        (0.3, [[0.0], [0.0]], "not in the prediction"),
        (0.3, [[0.0], [1.0]], " in the prediction"),
    ],
)
def test_the_field_is_shown_with_its_part_in_the_prediction(
    amplitude: float, mean: list[list[float]], said: str
) -> None:
    found = field_text({"amplitude_px": amplitude, "length_px": 420.0, "mean": mean})
    assert found.endswith(said)
    assert ("0.300 px over 420 px" in found) == (amplitude > 0.0)


def test_an_accepted_calibration_is_written_and_a_refused_one_replaces_nothing(
    sunarc: Sunarc, points: Path, tmp_path: Path
) -> None:
    target = tmp_path / "calibration.json"
    assert sunarc("calibrate", str(points), *AT_SGP, "-o", str(target)).code == 0
    written = json.loads(target.read_text())
    assert written["verdict"]["accepted"]
    points.write_text("\n".join(points.read_text().splitlines()[:40]))
    refused = sunarc("calibrate", str(points), *AT_SGP, "-o", str(target))
    assert refused.code == 1
    assert str(target) in refused.err
    assert json.loads(target.read_text()) == written


def test_a_refused_fit_shows_no_number_of_a_camera_and_answers_only_who_asks_for_it(
    sunarc: Sunarc, points: Path, tmp_path: Path
) -> None:
    points.write_text("\n".join(points.read_text().splitlines()[:40]))
    document = sunarc("calibrate", str(points), *AT_SGP, "--json").out
    shown = sunarc("calibrate", str(points), *AT_SGP).out
    assert not any(
        line.startswith(("focal", "principal", "pose", "phi", "1-sigma", "projection")) for line in shown.splitlines()
    )
    file, other = tmp_path / "refused.json", str(tmp_path / "camera.yml")
    file.write_text(document)
    for command in (("export", "--format", "opencv", "-o", other), ("unproject",), ("project",)):
        pixels = "x_px,y_px\n800,800\n" if command[0] == "unproject" else "zenith_deg,azimuth_deg\n10,10\n"
        asked = [*command, "--calibration", str(file)]
        refusal = sunarc(*asked, stdin=pixels)
        assert (refusal.code, refusal.out) == (2, "")
        assert "--accept-refused" in refusal.err
        assert sunarc(*asked, "--accept-refused", stdin=pixels).code == 0


def test_the_site_is_given_as_written_or_by_the_settings(sunarc: Sunarc, points: Path, tmp_path: Path) -> None:
    config = tmp_path / "sunarc.toml"
    config.write_text("[site]\nlatitude = 36.604043\nlongitude = -97.484856\naltitude = 318.0\n")
    by_settings = ("--config", str(config))
    written = ("--latitude", "36°36'14.555\"N", "--longitude", "97 29 5.482 W", "--altitude", "318")
    found = [
        json.loads(sunarc("calibrate", str(points), *given, "--image-size", "1748,1748", "--json").out)["site"]
        for given in (AT_SGP[:6], by_settings, written, (*by_settings, "--altitude", "300"))
    ]
    assert found[0] == found[1]
    assert found[2]["latitude"] == pytest.approx(36.604043, abs=1e-6)
    assert found[2]["longitude"] == pytest.approx(-97.484856, abs=1e-6)
    assert found[3] == {**found[0], "altitude": 300.0}


@pytest.mark.parametrize("angle", ["47°25'X", "96", "8E", "-47N"])
def test_a_latitude_that_is_none_is_named(sunarc: Sunarc, points: Path, angle: str) -> None:
    answer = sunarc("calibrate", str(points), "--latitude", angle, "--longitude", "1", "--image-size", "1748,1748")
    assert answer.code == 2
    assert answer.err.startswith("sunarc: --latitude: ")
    assert "[angle_" in answer.err


def test_the_uncertainty_holds_the_clock_and_the_detection_that_are_stated_and_no_more(
    sunarc: Sunarc, points: Path
) -> None:
    """2 s of the clock turn the camera by 0.0083° about the pole, and 0.07 px along the radius are 0.007°."""

    def sky_rms_deg(*stated: str) -> float:
        return float(
            json.loads(sunarc("calibrate", str(points), *AT_SGP, *stated, "--json").out)["uncertainty"]["sky_rms_deg"]
        )

    loose, bounded = sky_rms_deg("--clock-error", "2"), sky_rms_deg("--clock-error", "0.1")
    both, wide = sky_rms_deg("--clock-error", "0.1", "--outwards-px", "0.01"), sky_rms_deg("--clock-error", "60")
    # about the pole by 15 arcseconds a second, seen per axis from 36° of latitude
    turn_deg = 2.0 * 15.0 / 3600.0 * math.sqrt((1.0 + math.cos(math.radians(90.0 - 36.6)) ** 2) / 4.0)
    assert bounded == pytest.approx(math.sqrt(loose**2 - turn_deg**2), rel=0.15)
    outwards_deg = 0.007 / math.sqrt(2.0)  # of the two axes of a direction one is along the radius
    assert both == pytest.approx(math.sqrt(bounded**2 - outwards_deg**2), rel=0.02)
    assert wide == pytest.approx(30.0 * turn_deg, rel=0.2)


def test_what_stars_alone_do_not_show_and_no_bound_are_refused_by_their_option(
    sunarc: Sunarc, points: Path, tmp_path: Path
) -> None:
    head, *rows = points.read_text().splitlines()
    stars = tmp_path / "stars.csv"
    stars.write_text("\n".join([head, *(row.replace(",sun", ",star:HIP32349") for row in rows)]))
    answer = sunarc("calibrate", str(stars), *AT_SGP, "--outwards-px", "0.01")
    assert (answer.code, "--outwards-px" in answer.err) == (2, True)
    assert sunarc("calibrate", str(points), *AT_SGP, "--clock-error", "-1").code == 2


@pytest.mark.parametrize("air", ["15.0", ""])
def test_air_may_be_constant_or_missing(sunarc: Sunarc, points: Path, air: str) -> None:
    write_air(points, [air, air])
    answer = sunarc("calibrate", str(points), *AT_SGP, "--json")
    assert (answer.code, json.loads(answer.out)["verdict"]["accepted"]) == (0, True)


@pytest.mark.parametrize("absurd", ["999", "-300", "warm"])
def test_absurd_air_is_refused_with_its_line_and_column(sunarc: Sunarc, points: Path, absurd: str) -> None:
    write_air(points, ["15.0", absurd])
    answer = sunarc("calibrate", str(points), *AT_SGP)
    assert answer.code == 2
    assert "line 3, temperature_c" in answer.err


def write_air(path: Path, degrees: list[str]) -> None:
    """Write air temperatures by turns into a table of sightings."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    names = ["time_utc", "x_px", "y_px", "temperature_c"]
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, names, extrasaction="ignore")
        table.writeheader()
        table.writerows({**row, "temperature_c": degrees[k % len(degrees)]} for k, row in enumerate(rows))
