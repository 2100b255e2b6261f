from __future__ import annotations

import io
import math
import tracemalloc
from datetime import UTC, datetime

import numpy as np
import pytest

from sunarc.common.errors import InputError
from sunarc.formats.csv_files import read_pairs, read_sightings, write_columns, write_sightings
from sunarc.sky.night import body_directions
from sunarc.sky.site import Site

SITE = Site(latitude=36.604, longitude=-97.485, altitude=318.0)
HEADER = "time_utc,x_px,y_px,sigma_px,body"
ROW = "2013-05-13T18:30:00Z,871.5,883.25,0.01,sun"


def test_a_table_is_read_as_it_was_written() -> None:
    moment = datetime(2013, 5, 13, 18, 30, 0, 250_000, tzinfo=UTC)
    file = io.StringIO()
    assert write_sightings(file, [(moment, 871.5, 883.25, 0.01, "sun"), (moment, 1.0, 2.0, None, "sun")]) == 2
    table = read_sightings(file.getvalue().splitlines(), name="points.csv")
    assert table.unix_s.tolist() == [moment.timestamp()] * 2
    assert table.pixels.tolist() == [[871.5, 883.25], [1.0, 2.0]]
    assert table.sigma_px[0] == 0.01
    assert np.isnan(table.sigma_px[1])


def test_sigma_and_body_may_be_left_out_and_columns_may_stand_in_any_order() -> None:
    table = read_sightings(["y_px,time_utc,x_px", "2,2013-05-13T13:30:00-05:00,1"], name="points.csv")
    assert table.pixels.tolist() == [[1.0, 2.0]]
    assert table.unix_s.tolist() == [datetime(2013, 5, 13, 18, 30, tzinfo=UTC).timestamp()]


def test_times_of_any_form_are_those_that_python_reads() -> None:
    times = ["2013-05-13T18:30:00.123456Z", "2013-05-13 18:30:01.5Z", "1969-12-31T23:59:59.9Z", "2013-05-13T18:30:02Z"]
    usual = read_sightings([HEADER, *(f"{time},1,2,," for time in times)], name="points.csv")
    mixed = read_sightings(
        [HEADER, *(f"{time},1,2,," for time in [*times, "20130513T183000+00:00"])], name="points.csv"
    )
    expected = [datetime.fromisoformat(time).timestamp() for time in times]
    assert usual.unix_s.tolist() == mixed.unix_s[:4].tolist() == expected


def test_of_many_faults_the_first_row_is_named() -> None:
    rows = [ROW] * 30_000
    rows[20_100], rows[20_050], rows[25_000] = "2013-02-30T00:00:00Z,1,2,,", "2013-05-13T18:30:00Z,1,x,,", "short"
    with pytest.raises(InputError, match="line 20052, y_px: 'x'"):
        read_sightings([HEADER, *rows], name="points.csv")
    with pytest.raises(InputError, match="line 20102, time_utc: '2013-02-30T00:00:00Z'"):
        read_sightings([HEADER, *rows[:20_050], ROW, *rows[20_051:]], name="points.csv")


def test_reading_takes_memory_for_the_numbers_not_for_the_text() -> None:
    lines = [HEADER, *(f"2013-05-13T18:{n // 60 % 60:02d}:{n % 60:02d}Z,{n},883.25,0.01," for n in range(100_000))]
    tracemalloc.start()
    table = read_sightings(iter(lines), name="points.csv")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(table) == 100_000
    assert peak < 500 * len(table)


def test_empty_lines_and_a_byte_order_mark_do_no_harm() -> None:
    assert read_sightings(["\ufeff" + HEADER, "", ROW, " "], name="points.csv").unix_s.size == 1


@pytest.mark.parametrize(
    ("row", "told"),
    [
        ("2013-05-13T18:30:00Z,871.5", "line 3: 2 cells for 5 columns"),
        ("yesterday,871.5,883.25,0.01,sun", "line 3, time_utc: 'yesterday'"),
        ("2013-05-13T18:30:00,871.5,883.25,0.01,sun", "line 3, time_utc: .* has no time zone"),
        ("2013-05-13T18:30:00Z,nan,883.25,0.01,sun", "line 3, x_px: 'nan' is not a finite number"),
        ("2013-05-13T18:30:00Z,871.5,inf,0.01,sun", "line 3, y_px: 'inf' is not a finite number"),
        ("2013-05-13T18:30:00Z,871.5,883.25,-1,sun", "line 3, sigma_px: '-1' is not positive"),
        ("2013-05-13T18:30:00Z,871.5,883.25,0.01,moon", "line 3, body: 'moon' is not known"),
    ],
)
def test_a_bad_row_is_named_by_line_and_column(row: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        read_sightings([HEADER, ROW, row], name="points.csv")


def test_a_missing_column_and_an_empty_file_are_named() -> None:
    with pytest.raises(InputError, check=lambda error: error.field == "points.csv, line 1"):
        read_sightings(["time_utc,x_px"], name="points.csv")
    with pytest.raises(InputError, match="is empty"):
        read_sightings([], name="points.csv")


def test_pairs_are_read_by_their_names() -> None:
    assert read_pairs(["a,y_px,x_px", "0,2,1"], columns=("x_px", "y_px"), name="stdin").tolist() == [[1.0, 2.0]]


def test_a_number_that_is_not_known_is_an_empty_cell() -> None:
    file = io.StringIO()
    write_columns(
        file, {"x_px": np.array([1.5, np.nan]), "inside": np.array([1.0, 0.0])}, places={"x_px": 3, "inside": 0}
    )
    assert file.getvalue() == "x_px,inside\n1.500,1\n,0\n"


def test_measured_air_comes_with_the_sightings() -> None:
    lines = [
        "time_utc,x_px,y_px,temperature_c,pressure_hpa",
        "2013-05-13T12:00:00Z,900.5,871.2,35.5,975",
        "2013-05-13T12:00:30Z,901.5,871.3,,",
    ]
    table = read_sightings(lines, name="air.csv")
    assert (table.temperature[0], table.pressure[0]) == (35.5, 97_500.0)
    assert np.isnan([table.temperature[1], table.pressure[1]]).all()


@pytest.mark.parametrize(("cells", "column"), [("308.5,975", "temperature_c"), ("35.5,97500", "pressure_hpa")])
def test_air_in_other_units_is_refused(cells: str, column: str) -> None:
    lines = ["time_utc,x_px,y_px,temperature_c,pressure_hpa", f"2013-05-13T12:00:00Z,900.5,871.2,{cells}"]
    with pytest.raises(InputError, match=column):
        read_sightings(lines, name="air.csv")


def test_a_stated_direction_overrides_the_body() -> None:
    header = "time_utc,x_px,y_px,body,zenith_deg,azimuth_deg"
    rows = ["2013-05-13T06:00:00Z,1,2,star:HIP91262,30,90", "2013-05-13T18:00:00Z,3,4,sun,,"]
    found = read_sightings([header, *rows], name="points.csv").directions
    np.testing.assert_allclose(found[0], [0.5, 0.0, math.sqrt(0.75)], atol=1e-12)
    assert np.all(np.isnan(found[1]))


def test_stars_planets_and_the_moon_are_known_by_name_where_the_site_is() -> None:
    pytest.importorskip("ephem")
    header = "camera,time_utc,file,x_px,y_px,sigma_px,body,verdict,epoch"
    names = ("star:HIP91262", "moon", "jupiter", "sun")
    rows = [f"roof,2013-05-13T06:00:00Z,a.png,{n},2,0.1,{name},clear,001" for n, name in enumerate(names)]
    found = read_sightings([header, *rows], name="stars.csv", site=SITE)
    assert found.kind.tolist() == [1, 2, 1, 0]
    expected = body_directions(np.array(names), np.full(4, found.unix_s[0]), SITE)
    np.testing.assert_allclose(found.directions, expected, atol=1e-12)
    assert np.isfinite(expected[:3]).all()
    assert np.isnan(expected[3]).all()
    # before midnight in May Vega is half way up the eastern sky of 36.6 N
    assert found.directions[0, 0] > 0.6
    assert 0.7 < found.directions[0, 2] < 0.75
    with pytest.raises(InputError, match="line 3, body: 'star:HIP1' is not known"):
        read_sightings([header, rows[0], rows[0].replace("91262", "1")], name="stars.csv", site=SITE)
    with pytest.raises(InputError, match="line 2, body: 'star:HIP91262' is not known"):
        read_sightings([header, *rows], name="stars.csv")


def test_poses_are_in_the_order_of_their_first_times() -> None:
    days = {"1": 3, "2": 14, "10": 25, "b": 1}
    rows = [f"roof,2013-05-{day:02d}T18:30:00Z,1,2,{epoch}" for epoch, day in days.items()]
    rows += ["roof,2013-05-27T18:30:00Z,1,2,b", "roof,2013-05-26T18:30:00Z,1,2,1"]
    found = read_sightings(["camera,time_utc,x_px,y_px,epoch", *rows], name="s.csv")
    assert found.epoch.tolist() == [1, 2, 3, 0, 0, 1]


def test_the_epochs_of_a_camera_are_poses_and_two_cameras_are_refused() -> None:
    header = "camera,time_utc,x_px,y_px,epoch"
    row = "{},2013-05-13T18:30:00Z,871.5,883.25,{}"
    rows = [row.format("roof", epoch) for epoch in ("001", "002", "001")]
    assert read_sightings([header, *rows], name="s.csv").epoch.tolist() == [0, 1, 0]
    # without a camera an epoch is a column of somebody else's
    without = read_sightings(["time_utc,x_px,y_px,epoch", "2013-05-13T18:30:00Z,1,2,1368469800"], name="s.csv")
    assert without.epoch.tolist() == [0]
    with pytest.raises(InputError, match="2 cameras: mast, roof"):
        read_sightings([header, *rows, row.format("mast", "001")], name="s.csv")


@pytest.mark.parametrize(
    ("cells", "column"),
    [
        ("moon,30,", "azimuth_deg"),
        ("moon,,90", "zenith_deg"),
        ("moon,200,90", "zenith_deg"),
        ("moon,30,400", "azimuth_deg"),
    ],
)
def test_a_direction_in_part_or_out_of_bounds_is_refused(cells: str, column: str) -> None:
    header = "time_utc,x_px,y_px,body,zenith_deg,azimuth_deg"
    with pytest.raises(InputError) as refused:
        read_sightings([header, f"2013-05-13T06:00:00Z,1,2,{cells}"], name="points.csv")
    assert refused.value.field.endswith(column)


@pytest.mark.parametrize(
    ("header", "row"),
    [
        (HEADER.replace(",", ";"), "2013-05-13T18:30:00Z;871,5;883,25;0,01;sun"),
        (HEADER.replace(",", ";"), "2013-05-13T18:30:00,000Z;871.5;+883,25;1e-2;sun"),
        (HEADER.replace(",", "\t"), "2013-05-13T18:30:00Z\t871,5\t883.25\t,01\tsun"),
        ("\n\n" + HEADER, ROW),
    ],
)
def test_the_dialects_of_spreadsheets_are_read_alike(header: str, row: str) -> None:
    expected = read_sightings([HEADER, ROW], name="points.csv")
    found = read_sightings(f"{header}\n{row}\n".splitlines(), name="points.csv")
    assert found.pixels.tolist() == expected.pixels.tolist()
    assert (found.unix_s.tolist(), found.sigma_px.tolist()) == (expected.unix_s.tolist(), expected.sigma_px.tolist())


@pytest.mark.parametrize(
    ("lines", "line"),
    [
        ([HEADER, "2013-05-13T18:30:00Z,871,5,883,25,0,01,sun"], 2),  # decimal commas between commas
        ([HEADER.replace(",", ";"), "", "2013-05-13T18:30:00Z;1.871,5;883,25;0,01;sun"], 3),  # a point for thousands
        ([HEADER.replace(",", " "), "2013-05-13T18:30:00Z 871.5 883.25 0.01 sun"], 1),
    ],
)
def test_a_dialect_that_cannot_be_read_is_named_with_its_line(lines: list[str], line: int) -> None:
    with pytest.raises(InputError) as refused:
        read_sightings(lines, name="points.csv")
    assert refused.value.field.startswith(f"points.csv, line {line}")
