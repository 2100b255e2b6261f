"""Every table of an archive as files, each value as it was stored."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator
from datetime import UTC, date, datetime
from pathlib import Path

import h5py
import numpy as np
import pytest
from tests.fixtures.archive import new_archive

from sunarc.common.errors import InputError, OutsideError
from sunarc.common.findings import Finding
from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.values import Day, DayAir, Refit, SunPoint
from sunarc.imager.commands.archive_tables import export_everything, table_cell

FOUND = Finding("disc_found", {"chi2": 1.04})
NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)


@pytest.fixture
def archive(tmp_path: Path) -> Iterator[Archive]:
    with new_archive(tmp_path) as opened:
        epoch = opened.epochs.at("roof", NOON, reason="first frame").id
        seen = SunPoint(
            camera="roof", pose_epoch=epoch, time=NOON, method="disc", accepted=True, verdict="clear",
            x_px=3.25, y_px=2.5, sigma_px=0.04, exposure_us=20.0, findings=(FOUND,),
        )  # fmt: skip
        hidden = SunPoint(
            camera="roof", pose_epoch=epoch, time=NOON.replace(minute=31), method="disc", accepted=False,
            verdict="hidden",
        )  # fmt: skip
        opened.sightings.add([seen, hidden])
        opened.days.set_air(
            DayAir(camera="roof", date=date(2013, 5, 13), temperature_c=20.0, pressure_hpa=980.0, set_at=NOON)
        )
        yield opened


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_the_number_of_rows_is_told_by_file(archive: Archive, tmp_path: Path) -> None:
    counts = export_everything(tmp_path, tmp_path / "out")
    assert counts == {
        "cameras.csv": 1, "pose_epochs.csv": 1, "sun_points.csv": 2, "sun_points.nc": 2, "days.csv": 0,
        "day_air.csv": 1, "housekeeping_hour.csv": 0, "housekeeping_day.csv": 0, "refits.csv": 0,
        "events.csv": len(archive.events.find()), "calibrations/": 0,
    }  # fmt: skip
    written = {name: len(rows_of(tmp_path / "out" / name)) for name in counts if name.endswith(".csv")}
    assert written == {name: counts[name] for name in written}


@pytest.mark.usefixtures("archive")
def test_a_sightings_row_holds_its_values_and_empty_cells_where_it_has_none(tmp_path: Path) -> None:
    export_everything(tmp_path, tmp_path / "out")
    seen, hidden = rows_of(tmp_path / "out" / "sun_points.csv")
    assert (seen["time"], seen["x_px"], seen["sigma_px"], seen["accepted"]) == (
        "2013-05-13T18:30:00Z", "3.25", "0.04", "1",
    )  # fmt: skip
    assert (hidden["x_px"], hidden["sigma_px"], hidden["accepted"]) == ("", "", "0")
    assert (list(seen)[6], seen["reason"], hidden["reason"]) == ("reason", FOUND.text, "")
    assert [json.loads(row["findings"]) for row in (seen, hidden)] == [[FOUND.as_json()], []]


def test_days_keep_their_sentences_in_their_column_and_findings_are_json_in_the_last(
    archive: Archive, tmp_path: Path
) -> None:
    short = Finding("day_arc_too_short", {"arc_deg": 3.5, "least_deg": 15.0})
    day = Day(
        camera="roof", date=NOON.date(), verdict="unusable", findings=(short,), n=1, n_possible=2, decided_at=NOON
    )
    archive.days.save(day)
    archive.refits.add(Refit(id="r", camera="roof", requested_at=NOON, reason="by hand"))
    archive.refits.finish("r", state="failed", finished_at=NOON, message="short", findings=(short,))
    export_everything(tmp_path, tmp_path / "out")
    (written,) = rows_of(tmp_path / "out" / "days.csv")
    assert list(written)[:5] == ["camera", "date", "verdict", "reasons", "n"]
    assert list(written)[-1] == "findings"
    assert json.loads(written["reasons"]) == list(day.reasons)
    (refit,) = rows_of(tmp_path / "out" / "refits.csv")
    assert list(refit)[-2:] == ["message", "findings"]
    assert json.loads(refit["findings"]) == json.loads(written["findings"]) == [short.as_json()]


@pytest.mark.usefixtures("archive")
def test_the_netcdf_file_holds_the_numbers_with_units(tmp_path: Path) -> None:
    export_everything(tmp_path, tmp_path / "out")
    with h5py.File(tmp_path / "out" / "sun_points.nc") as file:
        np.testing.assert_array_equal(file["x_px"][()], [3.25, np.nan])
        np.testing.assert_array_equal(file["accepted"][()], [1, 0])
        np.testing.assert_array_equal(file["time"][()], [NOON.timestamp(), NOON.timestamp() + 60.0])
        assert file["sigma_px"].attrs["units"] == "px"


@pytest.mark.parametrize(
    ("value", "cell"),
    [
        (None, ""),
        (True, 1),
        (False, 0),
        (1.5, 1.5),
        ("a", "a"),
        (NOON, "2013-05-13T18:30:00Z"),
        (date(2013, 5, 13), "2013-05-13"),
        ({"a": [1, None]}, '{"a": [1, null]}'),
        ((Finding("c", {"n": 1, "x": math.nan}),), '[{"code": "c", "data": {"n": 1, "x": null}}]'),
    ],
)
def test_a_cell_is_the_value_as_text_or_number(value: object, cell: object) -> None:
    assert table_cell(value) == cell


@pytest.mark.usefixtures("archive")
def test_a_folder_that_holds_something_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        export_everything(tmp_path, tmp_path)
    assert refused.value.field == "folder"


@pytest.mark.usefixtures("archive")
def test_an_empty_folder_is_filled(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    assert export_everything(tmp_path, tmp_path / "out")["cameras.csv"] == 1


@pytest.mark.parametrize("below", [False, True])
@pytest.mark.usefixtures("archive")
def test_a_file_in_place_of_the_folder_is_an_outside_fault(tmp_path: Path, *, below: bool) -> None:
    (tmp_path / "out").write_text("in the way")
    with pytest.raises(OutsideError):
        export_everything(tmp_path, tmp_path / "out" / "more" if below else tmp_path / "out")
