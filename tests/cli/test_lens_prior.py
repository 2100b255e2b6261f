"""The options of `sunarc calibrate` that are of several cameras."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from tests.cli.test_calibrate import AT_SGP, CAMERA, write_day

from sunarc.formats.lens_prior import LENS_SCHEMA

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc


def test_a_lens_prior_is_written_combined_and_used(sunarc: Sunarc, tmp_path: Path) -> None:
    day, lens = write_day(tmp_path / "one.csv", CAMERA), tmp_path / "lens.json"
    answer = sunarc("calibrate", str(day), *AT_SGP, "--json", "--write-lens-prior", str(lens))
    assert answer.code == 0, answer.err
    assert json.loads(lens.read_text())["schema"] == LENS_SCHEMA
    document = tmp_path / "two.json"
    document.write_text(json.dumps({**json.loads(answer.out), "camera": "two"}))
    both = sunarc(
        "calibrate", "--write-lens-prior", str(lens), "--lens-of", str(document), "--unit-spread", "0.003,8,0.4,0.3"
    )
    assert both.code == 0, both.err
    assert json.loads(lens.read_text())["spread"]["center_px"] == 8.0
    few = tmp_path / "few.csv"
    rows = day.read_text().splitlines()
    few.write_text("\n".join([rows[0], *rows[60:72], ""]))
    posed = sunarc("calibrate", str(few), *AT_SGP, "--json", "--lens-prior", str(lens))
    assert posed.code == 0, posed.err
    codes = [finding["code"] for finding in json.loads(posed.out)["verdict"]["findings"]]
    assert "first_pose" in codes
    assert "lens_prior_used" in codes


def test_what_excludes_one_another_is_refused(sunarc: Sunarc, tmp_path: Path) -> None:
    day, lens = write_day(tmp_path / "one.csv", CAMERA), tmp_path / "lens.json"
    lens.write_text("{}")
    for more, field in (
        (("--lens-prior", str(lens), "--start", str(lens)), "--lens-prior"),
        (("--lens-prior", str(lens), "--write-lens-prior", str(lens)), "--write-lens-prior"),
        (("--lens-prior", str(lens)), "lens.json, schema"),
        (("--unit-spread", "1,2"), "--unit-spread"),
        (("--joint", str(lens)), "--output"),
    ):
        answer = sunarc("calibrate", str(day), *AT_SGP, *more)
        assert answer.code == 2
        assert field in answer.err


def test_a_joint_fit_prints_a_row_an_entry_and_exits_1_where_one_is_refused(sunarc: Sunarc, tmp_path: Path) -> None:
    write_day(tmp_path / "one.csv", CAMERA)
    (tmp_path / "few.csv").write_text("time_utc,x_px,y_px\n2013-05-13T18:30:00Z,800,700\n")
    spec = tmp_path / "joint.toml"
    entries = "".join(f'[[entry]]\ncamera = "{name}"\nfile = "{name}.csv"\n' for name in ("one", "few"))
    spec.write_text(f"latitude = 36.604043\nlongitude = -97.484856\nimage_size = [1748, 1748]\n{entries}")
    answer = sunarc("calibrate", "--joint", str(spec), "-o", str(tmp_path / "out"))
    assert answer.code == 1, answer.err
    assert "accepted" in answer.out
    assert "refused" in answer.out
    assert (tmp_path / "out" / "one.json").exists()
    listed = sunarc("calibrate", "--joint", str(spec), "-o", str(tmp_path / "out"), "--json")
    assert [one["verdict"]["accepted"] for one in json.loads(listed.out)] == [True, False]
