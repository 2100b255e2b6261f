"""A made archive from images to the report: what is known of it is found, and an interrupted run comes to the same."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
from collections import Counter
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from pyarrow import parquet
from tests.archives.in_process import InProcess
from tests.archives.made import MADE, analysed, indexed_in, tables_in
from tests.fixtures.postgresql import Server, postgresql
from tests.imager.web.test_dashboard import browser, in_a_browser, is_accessible, opened

from sunarc.archives.results import Summary, export_all_formats
from sunarc.common.errors import InputError, OutsideError
from sunarc.formats.calibration_document import from_document
from sunarc.formats.csv_files import read_sightings
from sunarc.imager.archive.database.state_folder import lock_state
from sunarc.lab.simulation.made_archive import true_times
from sunarc.sources import look

__all__ = ["postgresql"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("archive")


@pytest.fixture(scope="module")
def target(folder: Path) -> Path:
    return folder / "out"


@pytest.fixture(scope="module")
def summary(folder: Path, target: Path) -> Summary:
    with pytest.MonkeyPatch.context() as patch:
        found, _ = analysed(indexed_in(folder), target, patch)
    assert found is not None
    return found


def test_the_bump_and_the_hour_are_found(summary: Summary, target: Path) -> None:
    del summary
    epochs = json.loads((target / "epochs.json").read_text())
    found = [(one["camera"], one["epoch"], one["cause"], one["clock_offset_s"]) for one in epochs]
    assert found == [
        ("roof", "001", "start", 0.0),
        ("roof", "002", "moved", 0.0),
        ("mast", "001", "start", 0.0),
        ("mast", "002", "clock", 3600.0),
        ("mast", "003", "clock", 0.0),
    ]
    assert set(epochs[0]) >= {"camera", "epoch", "start", "end", "cause", "clock_offset_s", "calibration"}
    bump = MADE.first_day.timestamp() + 4 * 14 * 86_400 + 18.2 * 3600
    moved = epochs[1]["start"]
    assert "2013-04-07T18:1" <= moved <= "2013-04-07T20:0", bump


def test_sightings_have_the_time_that_the_suns_truly_have(summary: Summary, target: Path) -> None:
    del summary
    lines = (target / "sightings.csv").read_text().splitlines()
    rows = list(csv.DictReader(lines))
    assert rows == sorted(rows, key=lambda row: (row["camera"] != "roof", row["time_utc"], row["file"]))
    true = set(true_times(MADE).tolist())
    for camera in ("roof", "mast"):  # as `sunarc calibrate` reads the rows of one
        own = [line for line, row in zip(lines[1:], rows, strict=True) if row["camera"] == camera]
        table = read_sightings([lines[0], *own], name="sightings.csv")
        assert set(table.unix_s.tolist()) <= true
    assert 0.8 * len(true) < len(rows) / 2 < len(true)
    epochs = [row["epoch"] for row in rows if row["camera"] == "mast"]
    assert set(epochs) - {""} == {"001", "002", "003"}  # at a change the epoch of some is not sure


def test_a_sighting_is_of_an_epoch_within_its_stated_times_only(summary: Summary, target: Path) -> None:
    rows = list(csv.DictReader((target / "sightings.csv").read_text().splitlines()))
    for one in json.loads((target / "epochs.json").read_text()):
        key = one["camera"], one["epoch"]
        of_epoch = [row["time_utc"] for row in rows if (row["camera"], row["epoch"]) == key]
        start, end = (
            datetime.fromisoformat(one[name]) - timedelta(seconds=one["clock_offset_s"]) for name in ("start", "end")
        )
        assert (datetime.fromisoformat(of_epoch[0]), datetime.fromisoformat(of_epoch[-1])) == (start, end)
    accepted = sum(one["accepted"] for one in summary.report["cameras"])
    assert 0 <= accepted - sum(bool(row["epoch"]) for row in rows) <= 0.1 * accepted


def test_every_broken_file_is_listed_with_its_reason(summary: Summary, target: Path) -> None:
    del summary
    rows = list(csv.DictReader((target / "failures.csv").read_text().splitlines()))
    codes = sorted(row["code"] for row in rows if row["file"].startswith("roof/"))
    assert codes == [
        "file_not_image", "file_not_image", "file_size_differs", "file_too_many_pixels",
        "file_truncated", "stars_not_named",
    ]  # fmt: skip
    assert len(rows) == 2 * MADE.broken
    assert all(row["reason"] for row in rows)


def test_each_epoch_has_its_calibration_document(summary: Summary, target: Path) -> None:
    for one in json.loads((target / "epochs.json").read_text()):
        document = json.loads((target / one["calibration"]).read_text())
        assert (document["camera"], document["pose_epoch"]) == (one["camera"], one["epoch"])
        assert document["valid_from"][:19] == one["start"][:19]
        assert from_document(document).camera.width == MADE.size
        assert document["evidence"]["selection"].get("horizon_seen", 360) == 360
    assert len(summary.documents) == 5


def test_the_second_pass_finds_suns_that_the_first_did_not(summary: Summary) -> None:
    for one in summary.report["cameras"]:
        assert (
            one["accepted"] == one["accepted_first_pass"] + one["second_pass"]["found"] - one["second_pass"]["refused"]
        )
        assert one["second_pass"]["found"] > 0


def test_the_page_needs_no_other_file_and_shows_the_epochs(summary: Summary, target: Path) -> None:
    page = (target / "report.html").read_text()
    for one in summary.report["cameras"]:
        assert f"Images that were looked at: {one['by_verdict']['clear']} clear, " in page
        assert one["epochs"][0]["start"][11:16] in page
    assert re.findall(r'(?:src|href)="(?!data:)', page) == []
    assert page.count("<svg") == 4  # a time line and residuals for each camera
    assert page.count("data:image/jpeg;base64,") == 5
    assert all(word in page for word in ("roof", "mast", "moved", "clock", "+3600.0"))
    assert json.loads((target / "report.json").read_text())["failures"]["file_truncated"] == 2


def test_the_page_states_pose_and_uncertainty_of_each_epoch(summary: Summary, target: Path) -> None:
    page = (target / "report.html").read_text()
    n_epochs = sum(len(one["epochs"]) for one in summary.report["cameras"])
    assert len(re.findall(r"image top points to azimuth \d+°, tilted \d+\.\d° to the [a-z-]+</td>", page)) == n_epochs
    assert page.count("sky within 1.5°") == len(summary.report["cameras"])


@pytest.mark.browser
@in_a_browser
def test_the_page_fits_a_phone(summary: Summary, target: Path) -> None:
    assert summary.report["cameras"]
    with browser() as chromium:
        page = opened(chromium, (target / "report.html").absolute().as_uri(), width=390, height=844).page
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        assert page.evaluate("innerWidth") == 390
        is_accessible(page)
        if picture := os.environ.get("SUNARC_REPORT_PICTURE"):
            page.screenshot(path=picture, full_page=True)


def test_what_was_found_in_each_image_is_written_as_parquet(summary: Summary, target: Path) -> None:
    every = []
    for one in summary.report["cameras"]:
        path = target / "detections" / f"camera={one['camera']}" / "detections.parquet"
        rows = parquet.read_table(path, partitioning=None).to_pylist()
        assert len(rows) == one["images"]
        assert sum(row["accepted"] for row in rows) == one["accepted"]
        assert Counter(row["verdict"] for row in rows if row["verdict"]) == one["by_verdict"]
        assert all(row["code"] and row["time_utc"].tzinfo is not None for row in rows)
        assert any(row["predicted"] for row in rows)
        every += [row for row in rows if row["accepted"]]
    lines = (target / "sightings.csv").read_text().splitlines()
    written = {(float(row["x_px"]), float(row["y_px"])) for row in csv.DictReader(lines)}
    assert {(round(row["x_px"], 4), round(row["y_px"], 4)) for row in every} == written


def test_an_interrupted_run_goes_on_and_comes_to_the_same(
    summary: Summary, folder: Path, target: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    del summary
    other = folder / "interrupted"
    indexed = indexed_in(folder)
    looked = []
    for most in (3, 9, None):  # within the first pass, within the second, to the end
        found, cluster = analysed(indexed, other, monkeypatch, most=most)
        assert (found is None) == (most is not None)
        looked += [(item.file, item.expectation) for chunk in cluster.chunks for item in chunk.items]
    assert len(looked) == len(set(looked))  # nothing twice
    assert tables_in(other) == tables_in(target)


def test_a_second_run_looks_at_nothing_and_writes_the_same(
    summary: Summary, folder: Path, target: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    del summary
    before = tables_in(target)
    _, cluster = analysed(indexed_in(folder), target, monkeypatch)
    assert (cluster.chunks, cluster.calls) == ([], [])
    assert tables_in(target) == before


def test_only_what_rests_on_something_else_is_made_again(
    summary: Summary, folder: Path, target: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    del summary
    out = tmp_path / "out"
    shutil.copytree(target, out)

    def export_all_formats(document: dict[str, Any]) -> tuple[dict[str, bytes], dict[str, str]]:
        return {"id.txt": document["id"].encode(), "part/map.nc": document["camera"].encode()}, {"colmap": "no"}

    monkeypatch.setattr("sunarc.archives.results.export_all_formats", export_all_formats)
    first, cluster = analysed(indexed_in(folder), out, monkeypatch, exports=True)
    assert set(cluster.calls) == {"export_all_formats"}
    files = {path: path.stat().st_mtime_ns for path in out.glob("exports/**/*.*")}
    second, cluster = analysed(indexed_in(folder), out, monkeypatch, exports=True)
    assert (cluster.chunks, cluster.calls) == ([], [])
    assert first is not None
    assert second is not None
    assert second.report["exports_missing"] == first.report["exports_missing"] != {}
    assert {path: path.stat().st_mtime_ns for path in out.glob("exports/**/*.*")} == files
    broken = next(iter(out.glob("exports/mast/*/part/map.nc")))
    broken.write_bytes(b"mask")
    _, cluster = analysed(indexed_in(folder), out, monkeypatch, exports=True)
    assert cluster.calls == ["export_all_formats"]
    assert broken.read_bytes() == b"mast"
    indexed = indexed_in(folder)
    fewer = replace(indexed.cameras[1], images=indexed.cameras[1].images[:-10])
    _, cluster = analysed(indexed._replace(cameras=[indexed.cameras[0], fewer]), out, monkeypatch, exports=True)
    assert cluster.calls.count("first_analysis") == cluster.calls.count("final_analysis") == 1  # of one camera
    analysed(indexed._replace(cameras=[indexed.cameras[0]]), out, monkeypatch, exports=True)
    assert list(out.glob("exports/roof/*"))
    assert not list(out.glob("exports/mast/*"))


def first_looks(cluster: InProcess) -> list[str]:
    """Return the files of the day that were looked at without a prediction."""
    chunks = [chunk for chunk in cluster.chunks if chunk.night is None]
    return [item.file for chunk in chunks for item in chunk.items if item.expectation is None and not item.outside]


def test_new_images_are_looked_at_alone(
    summary: Summary, folder: Path, target: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    del summary
    indexed = indexed_in(folder)
    fewer = replace(indexed.cameras[1], images=indexed.cameras[1].images[:-10])
    other = folder / "grown"
    analysed(indexed._replace(cameras=[fewer]), other, monkeypatch)
    _, cluster = analysed(indexed._replace(cameras=[indexed.cameras[1]]), other, monkeypatch)
    assert len(first_looks(cluster)) == 10
    assert tables_in(target) != tables_in(other)  # of one camera


def test_an_image_that_was_replaced_under_its_name_is_looked_at_again(
    summary: Summary, folder: Path, target: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    del summary
    before = indexed_in(folder).cameras[0]
    file = Path(before.images[3].address) / before.images[3].file
    former = file.read_bytes()
    shutil.copytree(target, tmp_path / "out")
    try:
        file.write_bytes(former[:-1] + b"\x00")  # of the same name and size
        _, cluster = analysed(indexed_in(folder), tmp_path / "out", monkeypatch)
    finally:
        file.write_bytes(former)
    assert first_looks(cluster) == [file.name]


def test_files_that_were_only_touched_are_read_and_not_looked_at_again(
    summary: Summary, folder: Path, target: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    del summary
    out = tmp_path / "out"
    shutil.copytree(target, out)
    touched = [Path(one.address) / one.file for one in indexed_in(folder).cameras[0].images]
    for file in touched:
        os.utime(file, (1.0, 1.0))
    with monkeypatch.context() as patch:
        patch.setattr(look, "detect_in_image", None)  # whoever calls it finds no sun
        _, cluster = analysed(indexed_in(folder), out, patch)
    asked = {item.file for chunk in cluster.chunks for item in chunk.items}
    assert asked == {file.name for file in touched}
    assert tables_in(out) == tables_in(target)
    _, cluster = analysed(indexed_in(folder), out, monkeypatch)
    assert cluster.chunks == []  # the new times stand in the ledger


def test_a_ledger_in_postgresql_gives_the_tables_of_one_in_sqlite(
    summary: Summary, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, postgresql: Server
) -> None:
    del summary
    target, url = folder / "out", postgresql.new_database(template="template0")
    store = url.render_as_string(hide_password=False)
    try:
        for most in (7, None):  # ended within the first pass, and on to the end
            found, cluster = analysed(indexed_in(folder), tmp_path / "out", monkeypatch, most=most, store=store)
            assert (found is None) == (most is not None)
        assert len(cluster.chunks) > 0
        assert tables_in(tmp_path / "out") == tables_in(target)
        _, again = analysed(indexed_in(folder), tmp_path / "again", monkeypatch, store=store)
        assert again.chunks == []
        assert tables_in(tmp_path / "again") == tables_in(target)
        assert not list(tmp_path.rglob("ledger.sqlite"))
    finally:
        postgresql.drop(url)


def test_a_second_run_into_one_folder_is_refused_while_the_first_one_lasts(
    summary: Summary, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    del summary
    with lock_state(tmp_path), pytest.raises(OutsideError, match=rf"\b{os.getpid()}\b"):
        analysed(indexed_in(folder), tmp_path, monkeypatch)
    assert not (tmp_path / "ledger.sqlite").exists()


def test_without_any_image_a_run_is_refused(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nothing = indexed_in(folder)._replace(cameras=[])
    with pytest.raises(InputError) as refused:
        analysed(nothing, tmp_path / "out", monkeypatch)
    assert refused.value.field == "SOURCE"
    assert not (tmp_path / "out").exists()


def test_a_calibration_is_written_in_all_formats(summary: Summary) -> None:
    document = next(iter(summary.documents.values()))
    files, refused = export_all_formats(document)
    names = {
        "map.nc",
        "calibration.nc",
        "opencv_fisheye.yml",
        "calib_results.txt",
        "sunarc.cameramodel",
        "calibration.json",
    }
    assert names <= set(files)
    assert refused == {}
    assert json.loads(files["calibration.json"])["id"] == document["id"]
