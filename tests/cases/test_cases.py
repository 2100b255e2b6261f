"""Tables, images and names of others, whose right answers are known: each case has its command and what is right.

The answers are those of the cases' own pages. What is still open is marked with its subject
and fails until it is built.
"""

from __future__ import annotations

import csv
import json
import math
import shlex
import shutil
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
from tests.archives.in_process import InProcess, use
from tests.fixtures.command_line import Sunarc, sunarc

from sunarc.archives.results import Summary
from sunarc.calibration.answers.covariance import project_with_covariance
from sunarc.calibration.model.sightings import Kind
from sunarc.cli import reanalyse as command
from sunarc.detection.values import Expectation
from sunarc.formats.calibration_document import from_document
from sunarc.formats.csv_files import read_sightings
from sunarc.optics.forward import project
from sunarc.sources.detect_files import detect_in_image
from sunarc.sources.index import Indexed

__all__ = ["sunarc"]

SHARED = Path(__file__).parents[2] / "../shared"
CASES = SHARED / "cases"
BERN = "--latitude 46.95 --longitude 7.45 --altitude 560"
RADIUS_95 = 2.4477
"""Radius that holds 95 % of a normal distribution of two dimensions, standard deviations."""


def case(name: str, *, of: Path = CASES) -> Path:
    if not (of / name).exists():
        pytest.skip(f"../shared/cases/{name} is not on this machine")
    return of / name


def still_open(subject: str) -> pytest.MarkDecorator:
    """Expect a test to fail until its subject is built; a crash is no such failure."""
    return pytest.mark.xfail(reason=subject, strict=True, raises=AssertionError)


def marks(subject: str) -> tuple[pytest.MarkDecorator, ...]:
    return (still_open(subject),) if subject else ()


# ---- Tables of sightings ----


SMALL = "--image-size 640,640"
AT_BERN = f"{BERN} --image-size 1920,1920"


class Fit(NamedTuple):
    """What `sunarc calibrate --json` answers, and the true directions with their pixels where they are known."""

    document: dict[str, Any]
    zenith_azimuth_deg: np.ndarray
    pixels: np.ndarray

    @property
    def accepted(self) -> bool:
        return bool(self.document["verdict"]["accepted"])

    @property
    def codes(self) -> set[str]:
        return {one["code"] for one in self.document["verdict"]["findings"]}

    def finding(self, code: str) -> dict[str, Any]:
        (found,) = (one["data"] for one in self.document["verdict"]["findings"] if one["code"] == code)
        return dict(found)

    def _predicted(self) -> tuple[np.ndarray, np.ndarray]:
        """Return by how much the true pixels are missed (n, 2), and the stated covariance (n, 2, 2)."""
        zenith, azimuth = np.radians(self.zenith_azimuth_deg).T
        directions = np.array([np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)]).T
        predicted, covariance = project_with_covariance(from_document(self.document), directions)
        return predicted - self.pixels, covariance

    def share_inside(self) -> float:
        """Return the share of the true pixels within the stated 95 %."""
        off, covariance = self._predicted()
        squared = np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off)
        return float(np.mean(squared <= RADIUS_95**2))

    @property
    def honest(self) -> bool:
        """Whether the error over the sky is within the stated 95 %."""
        off, covariance = self._predicted()
        per_axis = np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2)) / 2.0)
        return bool(np.sqrt(np.mean(np.sum(off**2, axis=-1))) <= RADIUS_95 * per_axis)


def refused_for(*codes: str) -> Callable[[Fit], bool]:
    return lambda fit: not fit.accepted and set(codes) <= fit.codes


def accepted_with(*codes: str) -> Callable[[Fit], bool]:
    return lambda fit: fit.accepted and set(codes) <= fit.codes


def exchanged(latitude: float, longitude: float) -> Callable[[Fit], bool]:
    """Refused, and the first finding names the site with latitude and longitude exchanged."""

    def right(fit: Fit) -> bool:
        first = fit.document["verdict"]["findings"][0]
        return (
            not fit.accepted
            and first["code"] == "camera_tilted_by_exchange"
            and (first["data"]["latitude"], first["data"]["longitude"]) == (latitude, longitude)
        )

    return right


TABLES = {
    # table: what is right, and the subject that is still open
    "n_equator-about-equinox--mirrored-untold--1-d_lens0": (
        lambda fit: not fit.accepted and bool(fit.codes & {"other_handedness_fits", "mirroring_ambiguous"}), ""),
    "h_two-cameras-row-by-row---5-deg-apart--1-d_lens0": (refused_for("epoch_does_not_explain_its_days"), ""),
    "f_latitude--5-deg--1-d_lens0": (refused_for("camera_tilted_by_latitude", "tilt_in_doubt"), ""),
    "j_clock-ahead-constant--3-min--4-d_lens0": (accepted_with("clock_unbounded"), ""),
    "q_clock-ahead-60-s-on-the-last-2-of-4-days_lens0": (
        lambda fit: "clock_changed" in fit.codes or (fit.accepted and fit.honest), ""),
    "c_last-2-of-4-days-resized-0-998_lens0": (
        lambda fit: fit.accepted and fit.honest and "picture_changed" in fit.codes, ""),
    "l_cut-to-whole-pixels----5-px---4-d_lens2": (lambda fit: fit.honest and "pixels_on_grid" in fit.codes, ""),
    "a_cut-to-whole-minutes--cadence-60-s-at--37--4-d_lens1": (
        lambda fit: fit.honest and "times_without_seconds" in fit.codes, ""),
    "nasty_6--pixel-1-02-wide--1-day_lens4": (lambda fit: fit.honest, "pixels that are not square, on one day"),
    "o_mast-turns--05-deg-h-about-the-vertical--1-d_lens0": (
        lambda fit: not fit.accepted or fit.honest, "a mount that moves within the day"),
    "s_season-3e-4-52-weeks-REFUSED": (
        lambda fit: fit.accepted and fit.honest, ""),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "right"),
    [pytest.param(name, right, id=name, marks=marks(subject)) for name, (right, subject) in TABLES.items()],
)
def test_a_table_whose_truth_is_known_is_answered_rightly(
    sunarc: Sunarc, name: str, right: Callable[[Fit], bool]
) -> None:
    truth = json.loads(case(f"engine/{name}.json").read_text(encoding="utf-8"))
    table = str(case(f"engine/{name}.csv"))
    arguments = [table if one == "FILE" else one for one in shlex.split(truth["command"])[1:]]
    answer = sunarc(*arguments, "--json")
    over_sky = np.array(truth["true_over_sky"])
    fit = Fit(json.loads(answer.out), over_sky[:, :2], over_sky[:, 2:])
    assert answer.code == (0 if fit.accepted else 1)
    assert right(fit), fit.document["verdict"]["reasons"]


def test_every_table_whose_truth_is_known_is_asked() -> None:
    assert {path.stem for path in case("engine").glob("*.csv")} == set(TABLES)


SITES = {
    # table, what is typed: what is right, and the subject that is still open
    "a swapped site": (
        "02-wrong-site/athens-37.98-23.73.csv", f"--latitude 23.73 --longitude 37.98 {SMALL}",
        exchanged(37.98, 23.73), ""),
    "the right site of the swapped one": (
        "02-wrong-site/athens-37.98-23.73.csv", f"--latitude 37.98 --longitude 23.73 {SMALL}",
        accepted_with("site_assumed"), ""),
    "a wrong sign of the longitude that nothing shows": (
        "02-wrong-site/paris-48.85-2.35.csv", f"--latitude 48.85 --longitude -2.35 {SMALL}",
        accepted_with("site_assumed", "clock_unbounded"), ""),
    "another swapped site": (
        "02-wrong-site/doha-25.3-51.5-march.csv", f"--latitude 51.5 --longitude 25.3 {SMALL}",
        exchanged(25.3, 51.5), ""),
    "15 minutes ahead, which nothing shows": (
        "03-clock/clock-15min-ahead-46.95-7.45.csv", AT_BERN, accepted_with("clock_unbounded"), ""),
    "25 minutes ahead": (
        "03-clock/clock-25min-ahead-46.95-7.45.csv", AT_BERN, refused_for("tilt_in_doubt"), ""),
    "a clock that is set on Sundays": (
        "03-clock/clock-loses-30s-a-day-set-on-sundays.csv", AT_BERN,
        refused_for("clock_unsteady"), ""),
}  # fmt: skip


@pytest.mark.parametrize(
    ("table", "site", "right"),
    [
        pytest.param(table, site, right, id=name, marks=marks(subject))
        for name, (table, site, right, subject) in SITES.items()
    ],
)
def test_a_wrong_site_or_clock_is_named_where_the_sightings_show_it(
    sunarc: Sunarc, table: str, site: str, right: Callable[[Fit], bool]
) -> None:
    fit = _calibrated(sunarc, case(f"scout/{table}"), site)
    assert right(fit), fit.document["verdict"]["reasons"]


def test_a_clock_that_would_make_the_camera_level_is_named_with_its_longitude(sunarc: Sunarc) -> None:
    """The clock is 25 minutes ahead, which is 6.25 degrees of longitude: both are given, and hold the truth."""
    table = case("scout/03-clock/clock-25min-ahead-46.95-7.45.csv")
    fit = _calibrated(sunarc, table, AT_BERN)
    named = fit.finding("camera_tilted_by_clock")
    assert abs(named["minutes"] - 25.0) < 2.0 * named["minutes_sigma"] < 30.0
    assert abs(named["longitude_off_deg"] - 6.25) < 2.0 * named["longitude_sigma_deg"] < 7.5


FE4 = "--latitude -54.4959 --longitude 11.237683 --altitude 9 --image-size 1920,1920"


@pytest.mark.parametrize("mirrored", ["no", "auto"])
def test_a_wrong_hemisphere_is_refused_with_the_latitude_of_the_other_sign_named(sunarc: Sunarc, mirrored: str) -> None:
    track = case("real/fe4_2016-08-30.csv", of=SHARED)
    fit = _calibrated(sunarc, track, f"{FE4} --mirrored {mirrored}")
    first = fit.document["verdict"]["findings"][0]
    assert not fit.accepted
    assert first["code"] in {"latitude_of_other_sign_fits", "other_handedness_fits", "other_handedness_alone_fits"}
    assert first["data"]["latitude"] == 54.4959


HALF_DAYS = {
    # track: where it was taken, and the subject that is still open
    "straight_morning": ("--latitude 54.4947 --longitude 11.24082 --altitude 9", ""),
    "FE4_afternoon": ("--latitude 54.49587 --longitude 11.23768", ""),
}


@pytest.mark.parametrize(
    ("name", "site"),
    [pytest.param(name, site, id=name, marks=marks(subject)) for name, (site, subject) in HALF_DAYS.items()],
)
def test_half_a_day_is_refused_or_states_what_it_misses_in_the_other_half(sunarc: Sunarc, name: str, site: str) -> None:
    fit = _calibrated(sunarc, case(f"real/{name}.fit.csv"), f"{site} --image-size 1920,1920")
    with case(f"real/{name}.test.csv").open(encoding="utf-8") as file:
        held = np.array(
            [[float(row[of]) for of in ("el_deg", "az_deg", "x_px", "y_px")] for row in csv.DictReader(file)]
        )
    other = fit._replace(zenith_azimuth_deg=np.column_stack([90.0 - held[:, 0], held[:, 1]]), pixels=held[:, 2:])
    assert not fit.accepted or other.share_inside() >= 0.9


def test_a_part_that_is_missed_by_less_than_is_stated_is_not_called_contradicted(sunarc: Sunarc) -> None:
    fit = _calibrated(
        sunarc, case("real/mali_alt30b.csv"), "--latitude 13.03 --longitude -11.38 --altitude 150 --image-size 1280,960"
    )
    assert "direction_sigma_too_large" in fit.codes
    contradicted = [one["data"] for one in fit.document["verdict"]["findings"] if one["code"] == "held_out_contradicts"]
    assert all(one["rmse_px"] > one["stated_px"] for one in contradicted)


def test_a_few_biased_suns_do_not_veto_the_stars(sunarc: Sunarc) -> None:
    table = case("peers/mix2.csv")
    fit = _calibrated(sunarc, table, "--latitude 37.0916 --longitude -2.3636 --altitude 490.6 --image-size 1000,1000")
    assert fit.accepted
    assert "day_contradicts_night" in fit.codes
    assert fit.document["uncertainty"]["sky_rms_deg"] < 0.03
    # the stars alone, whose camera is right to 0.02 degrees
    points = read_sightings(table.read_text(encoding="utf-8").splitlines(), name="mix2")
    stars = points.select(points.kind == Kind.STAR)
    off = np.linalg.norm(stars.pixels - project(from_document(fit.document).camera, stars.directions), axis=-1)
    assert 0.04 < np.median(off) < 0.1


def _calibrated(sunarc: Sunarc, table: Path, options: str) -> Fit:
    answer = sunarc("calibrate", str(table), *options.split(), "--json")
    return Fit(json.loads(answer.out), np.empty((0, 2)), np.empty((0, 2)))


# ---- Images ----


SUNS = {
    # image: where the sun is, and the subject that is still open
    "scout/11-small-circle/800x800_circle25pct.png": ((373.44, 449.24), ""),
    "scout/11-small-circle/880x880_circle21pct.png": ((413.44, 489.24), ""),
    "peers/crop700.png": ((505.56, 220.38), ""),
    "peers/full1000.png": ((705.56, 220.38), ""),
}


@pytest.mark.parametrize(
    ("image", "place"),
    [pytest.param(image, place, id=image, marks=marks(subject)) for image, (place, subject) in SUNS.items()],
)
def test_the_same_sun_is_found_whatever_the_size_of_its_image(
    sunarc: Sunarc, image: str, place: tuple[float, float]
) -> None:
    (found,) = json.loads(sunarc("detect", str(case(image)), "--json").out)
    assert found["verdict"] == "clear"
    assert math.dist((found["x_px"], found["y_px"]), place) < 0.3


@pytest.mark.parametrize(
    ("name", "left", "top", "seen", "sun"),
    [
        ("false_sun_fe3_20160901_095600Z.png", 260, 980, (504.116, 1157.8219), (472.5, 1209.6)),
        ("false_sun_fe4_20160901_094000Z.png", 620, 150, (852.7727, 326.5142), (842.1, 377.1)),
    ],
)
def test_gaps_in_broken_cloud_are_no_suns(
    name: str, left: int, top: int, seen: tuple[float, float], sun: tuple[float, float]
) -> None:
    image = cv2.imread(str(case(f"real/{name}")))
    assert image is not None
    whole = np.full((1920, 1920, 3), 120, dtype=np.uint8)
    whole[top : top + image.shape[0], left : left + image.shape[1]] = image
    place = Expectation(x_px=seen[0], y_px=seen[1], uncertainty_px=10.0)
    for expectation in (None, place):
        found = detect_in_image(whole, expectation=expectation)
        if found.accepted:
            off = np.hypot((found.x_px or 0.0) - sun[0], (found.y_px or 0.0) - sun[1])
            assert off <= 5.0 * (found.sigma_px or 0.0)


NIGHTS = {
    # image: where it was taken, and the fewest stars
    "real/petnica_20151203_042345.jpg": (("44.2466", "19.9306", "190"), ("--to-middle", "87"), 100),
    "real/trexrgb_gill_20211030_060500.png": (("56.3767", "-94.6437", "135"), (), 20),
}


@pytest.mark.parametrize("image", NIGHTS)
def test_the_stars_of_a_single_image_are_named(sunarc: Sunarc, image: str) -> None:
    document = _blind(sunarc, image)
    assert document["accepted"]
    assert document["images"][0]["n_stars"] >= NIGHTS[image][2]


@pytest.mark.parametrize("image", NIGHTS)
def test_every_finding_of_an_image_whose_stars_are_not_named_has_a_sentence(sunarc: Sunarc, image: str) -> None:
    document = _blind(sunarc, image)
    assert document["accepted"] or (document["findings"] and document["reason"])
    assert "{'" not in document["reason"]


def _blind(sunarc: Sunarc, image: str) -> dict[str, Any]:
    (latitude, longitude, altitude), options, _ = NIGHTS[image]
    place = ("--latitude", latitude, "--longitude", longitude, "--altitude", altitude, "--utc-offset", "0")
    return dict(json.loads(sunarc("stars", str(case(image)), "--blind", *place, *options, "--json").out))


# ---- Files, their names and their times ----


class Read(NamedTuple):
    """What `sunarc reanalyse` makes of a folder before it looks at an image."""

    code: int
    err: str
    times: dict[str, float]
    """Seconds since 1970 by the file's name."""
    left_out: list[str]


@pytest.fixture
def read(sunarc: Sunarc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Read]:
    def run(folder: Path, *options: str) -> Read:
        seen: list[Indexed] = []

        def note(indexed: Indexed, *_: object, **__: object) -> Summary:
            seen.append(indexed)
            return Summary(report={"cameras": [], "failures": {}, "seconds": 0.0}, documents={})

        monkeypatch.setattr(command, "reanalyse", note)
        asked = ("reanalyse", str(folder), *BERN.split(), "--utc-offset", "0", "-o", str(tmp_path / "out"))
        answer = sunarc(*asked, "--yes", *options)
        images = [one for indexed in seen for camera in indexed.cameras for one in (*camera.images, *camera.nights)]
        left_out = [Path(one.file).name for indexed in seen for one in indexed.failures]
        return Read(answer.code, answer.err, {Path(one.file).name: one.unix_s for one in images}, left_out)

    return run


def at(text: str) -> float:
    return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()


def test_an_hour_of_the_afternoon_is_read_as_such_or_refused(read: Callable[..., Read]) -> None:
    seen = read(case("scout/04-names-am-pm"))
    for name, found in seen.times.items():
        assert found == datetime.strptime(name, "cam_%Y-%m-%d_%I-%M-%S_%p.jpg").replace(tzinfo=UTC).timestamp()
    assert seen.times or seen.left_out or seen.code == 2


def test_a_zone_that_a_name_states_holds_or_contradicts_the_option(read: Callable[..., Read], tmp_path: Path) -> None:
    folder = case("scout/06-offset-in-name")
    written = {path.name: datetime.strptime(path.stem, "%Y%m%dT%H%M%S%z").timestamp() for path in folder.iterdir()}
    dashes = "2024-08-23T09-30-00-006516+02-00.png"
    single = tmp_path / "single"
    single.mkdir()
    shutil.copy(case("peers/crop700.png"), single / dashes)
    for place, expected in ((folder, written), (single, {dashes: at("2024-08-23T07:30:00.006516")})):
        seen = read(place)
        assert all(found == pytest.approx(expected[name], abs=1e-3) for name, found in seen.times.items())
        assert seen.code == 2 or seen.left_out or seen.times.keys() == expected.keys()


@pytest.mark.parametrize("name", ["sky-CEST.jpg", "sky-GMTp530.jpg"])
def test_the_epoch_in_a_mobotix_header_goes_before_its_local_time(read: Callable[..., Read], name: str) -> None:
    seen = read(case("scout/07-mobotix"))
    assert seen.times.get(name) == pytest.approx(1718100000.323, abs=1e-3)


FITS = {
    "i_zone.fits": ("2024-06-11T09:30:00", ""),
    "f_mjd.fits": ("2024-06-11T11:30:00", ""),
    "l_beg.fits": ("2024-06-11T11:30:30", ""),  # the middle of DATE-BEG and DATE-END
    "j_space.fits": ("2024-06-11T11:30:00", ""),
    "h_underscore.fits": ("2024-06-11T11:30:00", ""),
}


@pytest.mark.parametrize(
    ("name", "time"),
    [pytest.param(name, time, id=name, marks=marks(subject)) for name, (time, subject) in FITS.items()],
)
def test_a_fits_file_is_dated_by_its_header(read: Callable[..., Read], name: str, time: str) -> None:
    assert read(case("scout/09-fits")).times.get(name) == pytest.approx(at(time), abs=1e-3)


def test_a_tile_compressed_fits_image_is_read(sunarc: Sunarc) -> None:
    assert sunarc("detect", str(case("scout/09-fits/x_rice.fits")), "--json").code in {0, 1}


def test_a_pattern_reads_a_date_in_folders(read: Callable[..., Read]) -> None:
    seen = read(case("scout/05-date-in-folders"), "--time-pattern", "%Y/%m/%d/%H%M%S")
    assert seen.times.get("044800.jpg") == at("2024-06-11T04:48:00")
    assert len(seen.times) == 6


def test_thumbnails_are_left_out_of_an_allsky_folder(read: Callable[..., Read]) -> None:
    assert len(read(case("scout/01-allsky-layout")).times) == 6


def test_a_folder_of_pgm_images_is_read(read: Callable[..., Read]) -> None:
    assert len(read(case("scout/08-pgm")).times) == 6


def test_pgm_images_are_read_by_detect(sunarc: Sunarc) -> None:
    images = sorted(case("scout/08-pgm").iterdir())
    found = json.loads(sunarc("detect", *map(str, images), "--json").out)
    assert [one["verdict"] for one in found].count("clear") >= 4


def test_the_orientation_of_exif_is_read_past_or_is_the_headline(
    sunarc: Sunarc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(InProcess(), monkeypatch)
    asked = ("reanalyse", str(case("scout/10-exif3")), *BERN.split(), "--utc-offset", "0", "-o", str(tmp_path / "out"))
    (camera,) = json.loads(sunarc(*asked, "--yes", "--no-exports", "--json").out)["cameras"]
    headline = [one["code"] for one in camera["findings"]][:1]
    assert camera["by_verdict"] or any("orient" in code for code in headline)


def test_an_image_that_is_mirrored_from_one_day_on_is_two_states(
    sunarc: Sunarc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(InProcess(), monkeypatch)
    asked = (
        "reanalyse",
        str(case("scout/12-flip-midway")),
        *BERN.split(),
        "--utc-offset",
        "0",
        "-o",
        str(tmp_path / "out"),
    )
    answer = sunarc(*asked, "--yes", "--no-exports", "--mirrored", "auto", "--json")
    (camera,) = json.loads(answer.out)["cameras"]
    epochs = [(one["start"] < "2024-06-13", one["end"] < "2024-06-13") for one in camera["epochs"]]
    assert set(epochs) == {(True, True), (False, False)}
