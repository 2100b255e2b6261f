"""Images of the night in, sightings of stars out, which sunarc calibrate takes beside the sun's."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from io import StringIO
from pathlib import Path

import cv2
import numpy as np
import pytest
from astropy.io import fits
from numpy.typing import NDArray
from tests.detection.stars.rendering import counted, expected
from tests.fixtures.calibrations import SITE, chosen_calibration
from tests.fixtures.command_line import Sunarc

from sunarc.calibration.answers.covariance import hemisphere, unproject_with_sigma
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.selection import MOST_STARS
from sunarc.common.errors import InputError
from sunarc.formats.calibration_document import from_document, to_document
from sunarc.formats.csv_files import read_sightings
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.public.star_files import (
    StarOptions,
    detect_star_image,
    detect_stars_in_file,
    find_stars,
    write_star_sightings,
)
from sunarc.sky.directions import angles_from_direction, angular_distance
from sunarc.sky.night import STAR, night_sky
from sunarc.sky.site import relative_air_mass
from sunarc.stars.blind_start import add_star_clock_error

SIZE = 640
CAMERA = Camera(
    width=SIZE,
    height=SIZE,
    projection="equisolid",
    focal_length_px=(220.0, 220.0),
    principal_point_px=(318.0, 321.0),
    rotation_cam_enu=(0.02, -0.03, 2.5),
)
TIMES = ("20260313_060000", "20260313_064000")


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return chosen_calibration(
        CAMERA,
        names=("principal_point_x_px", "principal_point_y_px"),
        covariance=0.01 * np.eye(2),
        orders=np.array([[1, 1]]),
    )


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return two images of a clear night, 40 minutes apart, with 150 hot pixels and a lamp."""
    folder = tmp_path_factory.mktemp("night")
    rng = np.random.default_rng(1)
    hot = rng.uniform(60.0, SIZE - 60.0, (150, 2)).round() + 0.2
    paths = [folder / f"allsky_{name}.png" for name in TIMES]
    for name, path in zip(TIMES, paths, strict=True):
        cv2.imwrite(str(path), night_image(rng, name, hot))
    return paths


def night_image(rng: np.random.Generator, name: str, hot: NDArray[np.float64]) -> NDArray[np.uint16]:
    """Return what the camera counts of the sky of a time, with hot pixels (n, 2)."""
    sky = night_sky(unix_s(name), SITE, faintest=5.5)
    zenith, _ = angles_from_direction(sky.directions)
    sky, zenith = sky.select(zenith < 84.0), zenith[zenith < 84.0]
    light = 400_000.0 * 10.0 ** (-0.4 * (sky.magnitude + 0.25 * (relative_air_mass(zenith) - 1.0)))
    places = np.concatenate([project(CAMERA, sky.directions), hot])
    electrons = np.r_[light, np.full(hot.shape[0], 25_000.0)]
    return counted(rng, expected(places, electrons, size=SIZE, width=1.0))


@pytest.mark.parametrize(
    ("flip", "said"),
    [
        (lambda image: image[::-1], "its rows in reverse order"),
        (lambda image: image[:, ::-1], "its columns in reverse order"),
        (lambda image: image.T, "x and y swapped"),
        (lambda image: np.random.default_rng(3).permutation(image.ravel()).reshape(image.shape), None),
    ],
)
def test_images_that_are_stored_otherwise_are_named_as_such(
    images: list[Path],
    calibration: Calibration,
    tmp_path: Path,
    flip: Callable[[NDArray[np.uint16]], NDArray[np.uint16]],
    said: str | None,
) -> None:
    for path in images:
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert image is not None
        cv2.imwrite(str(tmp_path / path.name), np.ascontiguousarray(flip(image.astype(np.uint16))))
    found = find_stars(sorted(tmp_path.iterdir()), calibration, StarOptions(full_scale=4095, gain_e_per_count=5.0))
    assert not any(one.as_json()["accepted"] for one in found)
    flips = {one.data["flip"] for image in found for one in image.findings if one.code == "stars_flipped"}
    assert flips == (set() if said is None else {said})


def unix_s(name: str) -> float:
    return datetime.strptime(name, "%Y%m%d_%H%M%S").replace(tzinfo=UTC).timestamp()


def test_the_stars_of_two_images_are_named_and_hot_pixels_are_not(images: list[Path], calibration: Calibration) -> None:
    found = find_stars(images, calibration, StarOptions(full_scale=4095, gain_e_per_count=5.0))
    assert [image.as_json()["accepted"] for image in found] == [True, True]
    target = StringIO()
    count = write_star_sightings(target, found, most=10_000)
    assert count == sum(image.as_json()["n_stars"] for image in found) > 250
    lines = target.getvalue().splitlines()
    assert lines[0] == "time_utc,x_px,y_px,sigma_px,body,zenith_deg,azimuth_deg"
    assert all(line.split(",")[4].startswith(STAR) or line.split(",")[4] in {"jupiter", "venus"} for line in lines[1:])
    table = read_sightings(lines, name="stars.csv")
    error = np.linalg.norm(project(CAMERA, table.directions) - table.pixels, axis=-1)
    assert np.median(error) < 0.15
    assert np.mean(error < 0.8) > 0.995
    normal = error / (table.sigma_px * np.sqrt(2.0))
    assert 0.6 < np.sqrt(np.median(normal**2) / 0.69) < 1.6
    assert set(table.unix_s) == {unix_s(name) for name in TIMES}
    few = StringIO()
    assert write_star_sightings(few, found) == MOST_STARS
    some = read_sightings(few.getvalue().splitlines(), name="few.csv")
    assert np.mean(some.sigma_px) < 0.8 * np.mean(table.sigma_px)
    east, north, _ = some.directions.T
    sectors = np.bincount(np.floor((np.arctan2(east, north) / (2.0 * np.pi) % 1.0) * 12.0).astype(int), minlength=12)
    assert sectors.min() >= 5
    # one image alone has as many hot pixels as bright stars: its pattern proves the camera, and they are left out
    (alone,) = find_stars(images[:1], calibration, StarOptions(full_scale=4095, gain_e_per_count=5.0))
    assert alone.as_json()["accepted"]
    of_one = StringIO()
    assert write_star_sightings(of_one, [alone], most=10_000) > 250
    named = read_sightings(of_one.getvalue().splitlines(), name="one.csv")
    off = np.linalg.norm(project(CAMERA, named.directions) - named.pixels, axis=-1)
    assert np.median(off) < 0.15
    assert np.mean(off < 0.8) > 0.99


def test_the_command_writes_them_beside_the_sun_and_refuses_another_hour(
    images: list[Path], calibration: Calibration, tmp_path: Path, sunarc: Sunarc
) -> None:
    now = datetime(2026, 3, 14, tzinfo=UTC)
    document = tmp_path / "calibration.json"
    document.write_text(
        json.dumps(
            to_document(
                calibration, id="c", camera="c", state="current", created_at=now, valid_from=now, valid_until=None,
                pose_epoch="", software_version="0",
            )
        )
    )  # fmt: skip
    sun = tmp_path / "sun.csv"
    sun.write_text("time_utc,x_px,y_px,temperature_c,pressure_hpa\n2026-03-13T18:00:00Z,300,310,21.5,980\n")
    out = tmp_path / "both.csv"
    paths = [str(path) for path in images]
    usual = ["--calibration", str(document), "--full-scale", "4095"]
    done = sunarc("stars", *paths, *usual, "--beside", str(sun), "-o", str(out))
    assert done.code == 0, done.err
    table = read_sightings(out.read_text().splitlines(), name="both.csv")
    assert table.unix_s.size == MOST_STARS + 1
    assert np.isnan(table.directions[0]).all()
    assert np.isfinite(table.directions[1:]).all()
    assert (table.temperature[0], table.pressure[0]) == (21.5, 98_000.0)
    assert np.isnan(table.temperature[1:]).all()
    late = sunarc("stars", *paths, *usual, "--utc-offset", "1", "--json")
    assert late.code == 1
    answer = json.loads(late.out)
    assert [one["accepted"] for one in answer] == [False, False]
    codes = {finding["code"] for one in answer for finding in one["findings"]}
    assert codes <= {"stars_few", "stars_not_explained", "stars_not_found"}


def test_without_a_calibration_the_command_finds_the_camera(images: list[Path], tmp_path: Path, sunarc: Sunarc) -> None:
    target, out = tmp_path / "roof.json", tmp_path / "stars.csv"
    site = ["--latitude", str(SITE.latitude), "--longitude", str(SITE.longitude), "--altitude", str(SITE.altitude)]
    usual = ["stars", *(str(path) for path in images), "--blind", "--full-scale", "4095"]
    done = sunarc(*usual, *site, "--write-calibration", str(target), "-o", str(out), "--json")
    assert done.code == 0, done.err
    answer = json.loads(done.out)
    assert answer["accepted"]
    assert answer["findings"][0]["code"] == "blind_found"
    assert [image["accepted"] for image in answer["images"]] == [True, True]
    document = json.loads(target.read_text())
    assert document["state"] == "candidate"
    found = from_document(document)
    assert not found.camera.mirrored
    sky = night_sky(unix_s(TIMES[0]), SITE, faintest=4.0).directions
    sky = sky[sky[:, 2] > 0.2]
    error = np.linalg.norm(project(found.camera, sky) - project(CAMERA, sky), axis=-1)
    assert 0.0 < np.median(error) < 0.1
    table = read_sightings(out.read_text().splitlines(), name="stars.csv")
    assert np.median(np.linalg.norm(project(CAMERA, table.directions) - table.pixels, axis=-1)) < 0.15


def test_one_image_is_enough_and_hot_pixels_are_none_of_its_stars(
    images: list[Path], tmp_path: Path, sunarc: Sunarc
) -> None:
    target, out = tmp_path / "roof.json", tmp_path / "stars.csv"
    site = ["--latitude", str(SITE.latitude), "--longitude", str(SITE.longitude), "--altitude", str(SITE.altitude)]
    usual = ["stars", str(images[0]), "--blind", "--full-scale", "4095", "--json"]
    done = sunarc(*usual, *site, "--write-calibration", str(target), "-o", str(out))
    assert done.code == 0, done.err
    answer = json.loads(done.out)
    codes = {finding["code"]: finding["data"] for finding in answer["findings"]}
    assert codes["blind_by_pattern"]["log10_chance"] < -50.0
    camera = from_document(json.loads(target.read_text())).camera
    sky = night_sky(unix_s(TIMES[0]), SITE, faintest=4.0).directions
    sky = sky[sky[:, 2] > 0.2]
    error = np.linalg.norm(project(camera, sky) - project(CAMERA, sky), axis=-1)
    assert 0.0 < np.median(error) < 0.2
    table = read_sightings(out.read_text().splitlines(), name="stars.csv")
    off = np.linalg.norm(project(CAMERA, table.directions) - table.pixels, axis=-1)
    assert np.median(off) < 0.15
    assert np.all(off < 2.0)
    # three hours late, and of half the Earth away
    for options in (["--utc-offset", "3", *site], ["--latitude", "-36.6", "--longitude", "80"]):
        wrong = sunarc(*usual, *options)
        assert wrong.code == 1
        assert not json.loads(wrong.out)["accepted"]


def test_a_pose_by_the_stars_is_as_sure_as_the_clock(images: list[Path], tmp_path: Path, sunarc: Sunarc) -> None:
    target = tmp_path / "roof.json"
    site = ["--latitude", str(SITE.latitude), "--longitude", str(SITE.longitude), "--altitude", str(SITE.altitude)]
    late = ["--to-middle", "120", "--clock-error", "120", "--write-calibration", str(target)]
    done = sunarc("stars", str(images[0]), "--blind", "--full-scale", "4095", "--json", *late, *site)
    assert done.code == 0, done.err
    found = from_document(json.loads(target.read_text()))
    assert found.evidence.clock_error_s == 120.0
    (said,) = [one.data for one in found.verdict.findings if one.code == "pose_or_clock"]
    assert said["turn_deg"] == pytest.approx(120.0 * 360.0 / 86164.0, rel=1e-4)
    sky = hemisphere(200)
    sky = sky[sky[:, 2] > 0.3]
    looked, sigma, _ = unproject_with_sigma(found, project(CAMERA, sky))
    off = np.degrees(angular_distance(looked, sky))
    assert 0.3 < np.sqrt(np.mean(off**2) / np.mean(2.0 * sigma**2)) < 1.5
    sure = add_star_clock_error(replace(found, covariance=1e-12 * found.covariance), 10.0, limit_deg=1.5)
    assert sure.sky_rms_deg < 0.2 * found.sky_rms_deg
    unsure = add_star_clock_error(found, 3600.0, limit_deg=1.5)
    assert unsure.verdict.findings[0].code == "direction_sigma_too_large"


def test_an_image_of_another_year_is_said_to_be_one(images: list[Path], tmp_path: Path, sunarc: Sunarc) -> None:
    other = tmp_path / "allsky_20280313_060000.png"
    cv2.imwrite(str(other), night_image(np.random.default_rng(2), "20280313_060000", np.zeros((0, 2))))
    site = ["--latitude", str(SITE.latitude), "--longitude", str(SITE.longitude), "--altitude", str(SITE.altitude)]
    done = sunarc("stars", str(images[0]), str(other), "--blind", "--full-scale", "4095", *site, "--json")
    assert done.code == 0, done.err
    found = json.loads(done.out)["images"]
    assert [image["accepted"] for image in found] == [True, True]
    said = [[one["data"] for one in image["findings"] if one["code"] == "stars_years_apart"] for image in found]
    assert said[0] == []
    assert said[1][0]["days"] == pytest.approx(731.0, abs=0.1)


def test_blind_needs_a_site_and_no_calibration(images: list[Path], tmp_path: Path, sunarc: Sunarc) -> None:
    path = str(images[0])
    for options in (["--blind"], ["--blind", "--calibration", str(tmp_path / "c.json")], []):
        refused = sunarc("stars", path, *options)
        assert refused.code == 2
        assert "--" in refused.err


def test_what_is_no_image_of_the_night_is_said(images: list[Path], calibration: Calibration, tmp_path: Path) -> None:
    text = tmp_path / "20260313_060000.png"
    text.write_text("no image")
    nameless = tmp_path / "night.png"
    nameless.write_bytes(images[0].read_bytes())
    black = tmp_path / "20260313_061000.png"
    cv2.imwrite(str(black), np.zeros((SIZE, SIZE), dtype=np.uint8))
    found = find_stars([text, nameless, black], calibration, StarOptions())
    assert [image.findings[0].code for image in found] == ["file_not_image", "file_time_unknown", "stars_few"]
    assert [image.as_json()["n_stars"] for image in found] == [0, 0, 0]
    assert write_star_sightings(StringIO(), found) == 0
    other = tmp_path / "20260313_062000.png"
    cv2.imwrite(str(other), np.zeros((100, 100), dtype=np.uint8))
    with pytest.raises(InputError) as refused:
        find_stars([other], calibration, StarOptions())
    assert refused.value.field == str(other)


def as_fits(image: Path, target: Path, **header: object) -> Path:
    """Write an image as FITS, unsigned by BZERO, and return its path."""
    counts = cv2.imread(str(image), cv2.IMREAD_UNCHANGED)
    fits.PrimaryHDU(counts, fits.Header(header)).writeto(target)
    return target


def test_fits_files_give_the_stars_of_the_same_pictures(
    images: list[Path], calibration: Calibration, tmp_path: Path
) -> None:
    begins = ["2026-03-13T05:59:57.5", "2026-03-13T06:39:57.5"]  # 2.5 s before the middle
    paths = [
        as_fits(image, tmp_path / f"{n}.fits", **{"DATE-OBS": begin, "EXPTIME": 5.0})
        for n, (image, begin) in enumerate(zip(images, begins, strict=True))
    ]
    options = StarOptions(full_scale=4095, gain_e_per_count=5.0, to_middle_s=100.0)  # which is for other files
    found = find_stars(paths, calibration, options)
    same = find_stars(images, calibration, StarOptions(full_scale=4095, gain_e_per_count=5.0))
    pairs = [(one.as_json(), other.as_json()) for one, other in zip(found, same, strict=True)]
    assert [{**one, "file": ""} for one, _ in pairs] == [{**other, "file": ""} for _, other in pairs]
    assert all(one["accepted"] for one, _ in pairs)


def test_an_image_of_another_site_is_refused_and_the_rest_is_done(
    images: list[Path], tmp_path: Path, sunarc: Sunarc
) -> None:
    header = {"DATE-OBS": "2026-03-13T05:59:57.5", "EXPTIME": 5.0}
    here = as_fits(images[0], tmp_path / "a.fits", SITELAT=SITE.latitude + 0.3, SITELONG=-SITE.longitude, **header)
    there = as_fits(images[1], tmp_path / "b.fits", OBSLAT=SITE.latitude + 3.0, OBSLONG=SITE.longitude, **header)
    site = ["--latitude", str(SITE.latitude), "--longitude", str(SITE.longitude), "--altitude", str(SITE.altitude)]
    usual = ["stars", "--blind", "--full-scale", "4095", *site, "--json"]
    done = sunarc(*usual, str(there), str(here))
    assert done.code == 1
    answer = json.loads(done.out)
    assert answer["accepted"]
    assert [image["accepted"] for image in answer["images"]] == [False, True]
    assert answer["images"][0]["findings"][0]["code"] == "file_other_site"
    assert answer["images"][0]["findings"][0]["data"]["apart_deg"] == pytest.approx(3.0, abs=0.01)
    assert sunarc(*usual, str(there)).code == 1


@pytest.mark.parametrize(
    ("name", "header", "code", "time"),
    [
        ("a.fits", {}, "file_time_header", None),
        ("a.fits", {"DATE-OBS": "yesterday"}, "file_time_header", None),
        ("a.fits", {"DATE-OBS": "2026-03-13T06:00:00", "TIMESYS": "TAI"}, "file_time_header", None),
        ("20260313_060000.fit", {}, "", 10.0),  # by its name: --to-middle is of it
        ("20260313_070000.fit", {"DATE-OBS": "2026-03-13T06:00:00"}, "", 10.0),  # the header without an exposure
        ("20260313_070000.fit", {"DATE-OBS": "2026-03-13T06:00:00", "EXPTIME": 8.0}, "", 4.0),
        ("20260313_070000.fit", {"DATE-AVG": "2026-03-13T06:00:03", "EXPTIME": 8.0}, "", 3.0),
    ],
)
def test_the_time_of_a_fits_file_is_that_of_its_header_or_it_is_refused(
    name: str, header: dict[str, object], code: str, time: float | None, tmp_path: Path
) -> None:
    dark = tmp_path / "dark.png"
    cv2.imwrite(str(dark), np.random.default_rng(1).poisson(90.0, (64, 64)).astype(np.uint16))
    one = detect_stars_in_file(as_fits(dark, tmp_path / name, **header), SITE, StarOptions(to_middle_s=10.0))
    assert [finding.code for finding in one.findings] == ([code] if code else [])
    began = datetime(2026, 3, 13, 6, tzinfo=UTC)
    assert one.time == (None if time is None else began + timedelta(seconds=time))


def test_a_file_that_is_no_fits_gets_its_reason(tmp_path: Path) -> None:
    (tmp_path / "a.fits").write_bytes(b"SIMPLE  = nothing")
    one = detect_stars_in_file(tmp_path / "a.fits", SITE, StarOptions())
    assert [finding.code for finding in one.findings] == ["file_not_image"]
    gone = detect_stars_in_file(tmp_path / "gone.fits", SITE, StarOptions())
    assert [finding.code for finding in gone.findings] == ["file_not_image"]


def test_wide_stars_are_measured_at_half_the_size_with_their_sigma() -> None:
    rng = np.random.default_rng(5)
    places = np.stack(np.meshgrid(np.arange(40.0, 440.0, 40.0), np.arange(40.0, 440.0, 40.0)), axis=-1).reshape(-1, 2)
    places += rng.uniform(-8.0, 8.0, places.shape)
    image = counted(rng, expected(places, rng.uniform(20_000.0, 60_000.0, len(places)), size=480, width=2.8))
    time = datetime(2026, 3, 13, 6, tzinfo=UTC)
    options = StarOptions(full_scale=4095, gain_e_per_count=5.0, reduced_by=2)
    stars = detect_star_image(image, time, SITE, options, name="wide").stars
    assert stars is not None
    apart = np.linalg.norm(stars.pixels[:, None] - places, axis=-1)
    near = np.min(apart, axis=-1) < 3.0
    assert np.count_nonzero(near) >= 0.95 * len(places)
    z = (stars.pixels[near] - places[np.argmin(apart[near], axis=-1)]) / stars.sigma_px[near, None]
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.3
    assert abs(np.median(z)) < 0.3
    assert np.median(stars.width_px[near]) == pytest.approx(2.8, rel=0.15)
