"""Times of every library, numbers of every shape, and one error with field, problem and remedy for what is wrong."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import sunarc
from sunarc.public.inputs import unix_seconds

FOLDER = Path(__file__).parents[2] / "docs" / "examples" / "front_door"
SITE = sunarc.Site(latitude=36.604, longitude=-97.485, altitude_m=318)
TIME = datetime(2013, 5, 13, 18, 30, 0, 123456, tzinfo=UTC)
ABROAD = TIME.astimezone(timezone(timedelta(hours=-6)))
NAIVE = datetime(2013, 5, 13, 18, 30)  # noqa: DTZ001 - naive on purpose


@pytest.fixture(scope="module")
def known() -> sunarc.Calibration:
    return sunarc.load(FOLDER / "calibration.json")


def index(unit: str) -> pd.DatetimeIndex:
    return pd.DatetimeIndex([TIME]).as_unit(unit)  # type: ignore[arg-type] # a unit


@pytest.mark.parametrize(
    "time",
    [
        TIME,
        ABROAD,
        "2013-05-13T18:30:00.123456Z",
        "2013-05-13T12:30:00.123456-06:00",
        np.datetime64("2013-05-13T18:30:00.123456"),
        np.datetime64("2013-05-13T18:30:00.123456000", "ns"),
        pd.Timestamp(TIME),
        pd.Timestamp(TIME).tz_convert("America/Chicago"),
    ],
)
def test_one_time_of_any_kind_is_the_same_second(time: Any) -> None:  # noqa: ANN401 - any kind
    assert unix_seconds(time).shape == ()
    assert float(unix_seconds(time)) == TIME.timestamp()
    assert unix_seconds([time]).tolist() == [TIME.timestamp()]
    assert unix_seconds(np.array([[time, time]])).tolist() == [[TIME.timestamp()] * 2]


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_pandas_of_any_unit_and_zone_is_the_same_second(unit: str) -> None:
    whole = TIME.replace(microsecond=0)
    times = pd.DatetimeIndex([whole, whole + timedelta(hours=1)]).as_unit(unit)  # type: ignore[arg-type] # a unit
    expected = [whole.timestamp(), whole.timestamp() + 3600.0]
    for zoned in (
        times,
        times.tz_convert("America/Chicago"),
        pd.Series(times),
        pd.Series(times.tz_convert("Asia/Tokyo")),
    ):
        assert unix_seconds(zoned).tolist() == expected
    assert unix_seconds(times.tz_localize(None).to_numpy()).tolist() == expected  # numpy's are UTC


def test_a_series_of_texts_or_of_python_s_times_is_taken_too() -> None:
    for series in (pd.Series(["2013-05-13T18:30:00.123456Z"]), pd.Series([TIME, ABROAD], dtype=object)):
        assert set(unix_seconds(series).tolist()) == {TIME.timestamp()}


def test_nanoseconds_are_kept() -> None:
    assert unix_seconds(np.datetime64("1970-01-01T00:00:00.000000250", "ns")) == pytest.approx(2.5e-7)


@pytest.mark.parametrize(
    ("time", "field"),
    [
        (NAIVE, "time"),
        ([TIME, NAIVE], "time[1]"),
        (pd.DatetimeIndex([NAIVE]), "time"),
        (pd.Series([NAIVE]), "time"),
        (pd.Timestamp(NAIVE), "time"),
        ("2013-05-13T18:30:00", "time"),
        ("noon", "time"),
        (1_368_469_800.0, "time"),
        ([1_368_469_800], "time[0]"),
        (None, "time"),
        (pd.NaT, "time"),
        (np.array(["2013-05-13T18:30", "NaT"], dtype="datetime64[s]"), "time[1]"),
        (np.array(["2013"], dtype="datetime64[Y]"), "time"),
        (pd.Series([TIME, None]), "time[1]"),
    ],
)
def test_a_time_without_a_zone_and_what_is_no_time_are_refused(time: Any, field: str) -> None:  # noqa: ANN401
    with pytest.raises(sunarc.InputError) as refused:
        sunarc.sun_position(time, SITE)
    assert refused.value.field == field
    assert refused.value.problem
    assert refused.value.remedy


def test_answers_have_the_shape_of_the_question(known: sunarc.Calibration) -> None:
    one = known.back_project(400.0, 880.0)
    assert isinstance(one.zenith_deg, float)
    assert isinstance(bool(one.inside), bool)
    assert one.enu.shape == (3,)
    grid = known.back_project(np.full((2, 3), 400.0), np.full((2, 3), 880.0))
    assert (grid.zenith_deg.shape, grid.enu.shape, grid.inside.shape) == ((2, 3), (2, 3, 3), (2, 3))
    assert np.all(grid.zenith_deg == one.zenith_deg)
    across = known.back_project(np.array([400.0, 500.0]), 880.0)
    assert across.sigma_deg.shape == (2,)
    assert known.back_project([], []).zenith_deg.shape == (0,)
    times = np.array([["2013-05-13T18:30", "2013-05-13T19:30"]], dtype="datetime64[m]")
    assert sunarc.sun_position(times, SITE).enu.shape == (1, 2, 3)
    seen = known.project(zenith_deg=[[10.0], [20.0]], azimuth_deg=[0.0, 90.0, 180.0])
    assert (seen.x_px.shape, seen.covariance_px2.shape) == ((2, 3), (2, 3, 2, 2))
    back = known.back_project(seen.x_px, seen.y_px)
    np.testing.assert_allclose(back.zenith_deg, [[10.0] * 3, [20.0] * 3], atol=1e-6)


def test_xarray_goes_in_and_comes_out_with_its_coordinates(known: sunarc.Calibration) -> None:
    xarray = pytest.importorskip("xarray")
    x = xarray.DataArray([400.0, 500.0], dims="column", coords={"column": [4, 5]})
    y = xarray.DataArray([880.0, 700.0, 600.0], dims="row")
    look = known.back_project(x, y)
    assert look.zenith_deg.dims == ("column", "row")
    assert look.zenith_deg.column.to_numpy().tolist() == [4, 5]
    assert look.enu.dims == ("column", "row", "component")
    assert float(look.zenith_deg[1, 2]) == known.back_project(500.0, 600.0).zenith_deg
    assert known.back_project(x, 880.0).inside.dims == ("column",)
    assert known.draw(3, seed=1).back_project(x, y).azimuth_deg.dims == ("draw", "column", "row")
    times = xarray.DataArray(np.array(["2013-05-13T18:30"], dtype="datetime64[ns]"), dims="time")
    assert sunarc.sun_position(times, SITE).azimuth_deg.dims == ("time",)
    every = known.to_xarray(every_pixel=False)
    assert every.zenith.dims == ("y", "x")


def sightings(**other: Any) -> sunarc.Sightings:  # noqa: ANN401 - what a test makes wrong
    columns: dict[str, Any] = {"time": ["2013-05-13T18:30:00Z"] * 2, "x_px": [1.0, 2.0], "y_px": [3.0, 4.0]}
    return sunarc.Sightings(**columns | other)


def fit(**other: Any) -> sunarc.Calibration:  # noqa: ANN401 - what a test makes wrong
    arguments: dict[str, Any] = {"sightings": sightings(), "site": SITE, "image_size": (1748, 1748)}
    return sunarc.calibrate(**arguments | other)


WRONG: list[tuple[Callable[[sunarc.Calibration], object], str]] = [
    (lambda _: sunarc.Site(latitude=200.0, longitude=0.0), "site.latitude"),
    (lambda _: sunarc.Site(latitude=math.nan, longitude=0.0), "site.latitude"),
    (lambda _: sunarc.Site(latitude="north", longitude=0.0), "site.latitude"),  # type: ignore[arg-type] # wrong on purpose
    (lambda _: sunarc.Site(latitude=0.0, longitude=0.0, altitude_m=1e9), "site.altitude_m"),
    (lambda _: sightings(x_px=[1.0]), "x_px"),
    (lambda _: sightings(x_px=[[1.0, 2.0]]), "x_px"),
    (lambda _: sightings(x_px=[1.0, math.nan]), "x_px[1]"),
    (lambda _: sightings(y_px=["a", "b"]), "y_px"),
    (lambda _: sightings(y_px=[1j, 2.0]), "y_px"),
    (lambda _: sightings(x_px=np.ma.masked_array([1.0, 2.0], mask=[False, True])), "x_px[1]"),
    (lambda _: sightings(sigma_px=0.0), "sigma_px"),
    (lambda _: sightings(zenith_deg=10.0), "zenith_deg, azimuth_deg"),
    (lambda _: sightings(body=7), "body"),
    (lambda _: sightings(body=["sun"] * 3), "body"),
    (lambda _: fit(sightings=sightings(body="vulcan")), "sightings, row 0, body"),
    (lambda _: fit(sightings=[1, 2]), "sightings"),
    (lambda _: fit(site=(36.6, -97.5)), "site"),
    (lambda _: fit(image_size=0), "image_size"),
    (lambda _: fit(image_size=(0, 0)), "image_size"),
    (lambda _: fit(image_size=(12, 12), sightings=sightings()), "image_size"),
    (lambda _: fit(image_size=(1748.5, 1748)), "image_size"),
    (lambda _: fit(image_size="big"), "image_size"),
    (lambda _: fit(projection="mercator"), "projection"),
    (lambda _: fit(projection=["equisolid"]), "projection"),
    (lambda _: fit(mirrored="perhaps"), "mirrored"),
    (lambda _: fit(method="magic"), "method"),
    (lambda _: fit(image_circle=(1.0, 2.0)), "image_circle"),
    (lambda _: fit(image_circle=(1.0, 2.0, -1.0)), "image_circle.radius"),
    (lambda _: fit(level_within_deg=math.nan), "level_within_deg"),
    (lambda _: fit(level_within_deg=200.0), "level_within_deg"),
    (lambda _: fit(clock_error_s=-1.0), "clock_error_s"),
    (lambda _: fit(outwards_px=-1.0), "outwards_px"),
    (lambda _: fit(outwards_px=math.nan), "outwards_px"),
    (lambda _: fit(pose_only=True), "pose_only"),
    (lambda _: fit(lens_within_px=1.0), "lens_within_px"),
    (lambda known: fit(start=known, pose_within_deg=1.0), "lens_within_px"),
    (lambda known: fit(start=known, image_size=(800, 800)), "start"),
    (lambda known: fit(start=known, projection="equidistant"), "start"),
    (lambda _: fit(sightings=sightings(x_px=[1e5, 2e5])), "sightings, sighting 1"),
    (lambda known: known.back_project([1.0, 2.0], [1.0, 2.0, 3.0]), "x_px, y_px"),
    (lambda known: known.back_project(math.nan, 1.0), "x_px"),
    (lambda known: known.back_project("left", 1.0), "x_px"),
    (lambda known: known.project(zenith_deg=[10.0, math.inf], azimuth_deg=0.0), "zenith_deg[1]"),
    (lambda known: known.geolocate(400.0, 880.0, cloud_height_m=-1.0), "cloud_height_m"),
    (lambda known: known.geolocate(400.0, 880.0, cloud_height_m=1500.0, time=NAIVE), "time"),
    (lambda known: known.draw(0, seed=1), "draws"),
    (lambda known: known.draw(2, seed=-1), "seed"),
    (lambda known: known.plot_residuals(), "sightings"),
    (lambda known: known.export("word", "x.doc"), "format"),
    (lambda _: sunarc.load(FOLDER / "none.json"), str(FOLDER / "none.json")),
    (lambda _: sunarc.load(FOLDER / "sun.csv"), "sun.csv"),
    (lambda _: sunarc.read_sightings(FOLDER / "calibration.json"), "calibration.json, line 1"),
    (lambda _: sunarc.find_sun(np.zeros((4, 4))), "image"),
    (lambda _: sunarc.find_sun(np.zeros((4, 4, 7), dtype=np.uint8)), "image"),
    (lambda _: sunarc.find_sun(FOLDER / "sun.csv"), str(FOLDER / "sun.csv")),
    (lambda _: sunarc.find_sun(FOLDER / "night.png", method="guess"), "method"),  # type: ignore[arg-type] # wrong
    (lambda known: sunarc.find_sun(FOLDER / "night.png", calibration=known), "time"),
    (lambda _: sunarc.find_stars(FOLDER / "night.png", time=TIME), "site"),
    (lambda _: sunarc.find_stars(FOLDER / "night.png", time=[TIME, TIME], site=SITE), "time"),
    (lambda known: sunarc.find_stars(FOLDER / "night.png", time=TIME, calibration=known), "image"),
]


@pytest.mark.parametrize(("wrong", "field"), WRONG)
def test_wrong_input_is_one_error_with_field_problem_and_remedy(
    wrong: Callable[[sunarc.Calibration], object], field: str, known: sunarc.Calibration
) -> None:
    with pytest.raises(sunarc.InputError) as refused:
        wrong(known)
    assert refused.value.field == field
    assert refused.value.problem
    assert refused.value.remedy
    assert "--" not in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_refused_fit_is_a_calibration_that_answers_only_when_asked_to() -> None:
    found = fit(sightings=sightings(x_px=[800.0, 810.0], y_px=[700.0, 700.0]))
    assert (found.verdict, found.accepted) == ("refused", False)
    assert found.reasons
    assert found.reasons[0] in str(found)
    for ask in (
        lambda **how: found.back_project(400.0, 880.0, **how),
        lambda **how: found.project(zenith_deg=10.0, azimuth_deg=0.0, **how),
        lambda **how: found.geolocate(400.0, 880.0, cloud_height_m=1000.0, **how),
        lambda **how: found.draw(2, seed=1, **how),
    ):
        with pytest.raises(sunarc.InputError) as refused:
            ask()
        assert refused.value.field == "calibration"
        assert "accept_refused=True" in refused.value.remedy
    assert math.isfinite(found.back_project(870.0, 880.0, accept_refused=True).zenith_deg)
    with pytest.raises(sunarc.InputError):
        sunarc.find_sun(FOLDER / "night.png", time=TIME, calibration=found)


def test_a_camera_of_another_program_answers_without_sigma_and_begins_a_fit(
    known: sunarc.Calibration, tmp_path: Path
) -> None:
    known.export("opencv", tmp_path / "camera.yml")
    other = sunarc.load(tmp_path / "camera.yml")
    assert (other.format, other.verdict, other.accepted) == ("opencv", "unstated", False)
    look, own = other.back_project(700.0, 880.0), known.back_project(700.0, 880.0)
    assert abs(look.zenith_deg - own.zenith_deg) < 0.2
    assert math.isnan(look.sigma_deg)
    with pytest.raises(sunarc.InputError):
        other.plot_uncertainty()
    with pytest.raises(sunarc.InputError):
        other.save(tmp_path / "x.json")
    text = (tmp_path / "camera.yml").read_bytes().replace(b"rotation_cam_enu", b"rotation_of_another")
    (tmp_path / "posed.yml").write_bytes(text)
    with pytest.raises(sunarc.InputError) as refused:
        sunarc.load(tmp_path / "posed.yml").back_project(700.0, 880.0)
    assert refused.value.field == "calibration"


def test_bodies_of_the_night_are_named_and_placed_by_the_site() -> None:
    named = sightings(body=["moon", "star:HIP32349"])
    (moon, sirius) = named.at(SITE).directions
    assert np.all(np.isfinite([moon, sirius]))
    assert np.all(np.isnan(named.points.directions))
    stated = sightings(zenith_deg=[10.0, 20.0], azimuth_deg=30.0)
    assert stated.at(SITE).directions[0, 2] == pytest.approx(math.cos(math.radians(10.0)))
