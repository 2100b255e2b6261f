"""The benchmark scores known errors as what they are, on both sides of every limit, and wrong entries with a code."""

from __future__ import annotations

import ast
import csv
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmark_second import LENSES as SECOND_LENSES
from benchmark_second import made
from tests.fixtures.command_line import Sunarc, sunarc

from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError
from sunarc.lab.studies.benchmark_cases import (
    CONDITIONS,
    LENSES,
    BenchmarkTruth,
    benchmark_case,
    neighbouring_directions,
)
from sunarc.lab.studies.benchmark_files import read_case, read_entry, read_round, read_truth, truth_hash, write_round
from sunarc.lab.studies.benchmark_scores import Answered, BandScore, Score, calibrate_case, collect_answers, score
from sunarc.sky.directions import angles_from_direction, direction_from_angles

__all__ = ["sunarc"]

STUDIES = Path(__file__).resolve().parents[3] / "docs" / "studies"
COUNT = 4000


def truth_of(count: int = COUNT, *, answerable: bool = True) -> BenchmarkTruth:
    """Return a sky that is drawn evenly in the zenith angle, 10 px a degree, with a fallback of 4 degrees."""
    rng = np.random.default_rng(3)
    zenith, azimuth = rng.uniform(1.0, 89.9, count), rng.uniform(0.0, 360.0, count)
    pixels = 10.0 * zenith[:, None] * np.stack([np.sin(np.radians(azimuth)), -np.cos(np.radians(azimuth))], axis=-1)
    return BenchmarkTruth(
        lens="equidistant",
        condition="clear",
        answerable=answerable,
        pixels=np.round(1000.0 + pixels, 3),
        directions=direction_from_angles(zenith_deg=zenith, azimuth_deg=azimuth),
        track_deg=np.where(azimuth < 180.0, 10.0, 60.0),
        px_per_deg=np.tile(10.0 * np.eye(2), (count, 1, 1)),
        fallback_deg=np.full(count, 4.0),
    )


def off_by(truth: BenchmarkTruth, down_deg: FloatArray | float, across_deg: FloatArray | float = 0.0) -> FloatArray:
    """Return the directions of a truth turned on the sphere, degrees to larger zenith angles and azimuths."""
    down, across = neighbouring_directions(truth.directions)
    step = np.multiply(np.radians(down_deg), down.T).T + np.multiply(np.radians(across_deg), across.T).T
    size = np.linalg.norm(step, axis=-1, keepdims=True)
    along = step / np.maximum(size, 1e-300)
    return np.asarray(np.cos(size) * truth.directions + np.sin(size) * along)


def scored(truth: BenchmarkTruth, answered: Answered) -> Score:
    return score("entrant", {"s000": truth}, {"s000": answered})


def band(one: Score, name: str = "all") -> BandScore:
    return next(found for found in one.bands if found.band == name)


def codes(one: Score) -> list[str]:
    return [finding.code for finding in one.findings]


def round_sigma(sigma_deg: float, count: int = COUNT) -> FloatArray:
    return np.tile(sigma_deg**2 * np.eye(2), (count, 1, 1))


@pytest.mark.parametrize("size", [1e-6, 0.1, 3.0, 120.0])
def test_an_error_is_scored_at_its_size(size: float) -> None:
    truth = truth_of()
    found = band(scored(truth, Answered(answer="answered", directions=off_by(truth, 0.0, size))))
    assert found.median_deg == pytest.approx(size, rel=1e-6)
    assert found.p90_px == pytest.approx(10.0 * size, rel=1e-5)
    assert math.isnan(found.within[0])


def test_an_error_of_one_band_is_in_that_band_alone() -> None:
    truth = truth_of()
    zenith = angles_from_direction(truth.directions)[0]
    wrong = np.where((zenith >= 60.0) & (zenith < 70.0), 1.0, 0.0)
    found = scored(truth, Answered(answer="answered", directions=off_by(truth, wrong)))
    assert [one.band for one in found.bands if one.median_deg > 0.5] == ["60-70"]
    assert sum(one.n for one in found.bands[:-2]) == band(found).n == COUNT
    far = scored(truth, Answered(answer="answered", directions=off_by(truth, np.where(truth.track_deg > 40.0, 1.0, 0))))
    assert band(far, "far").median_deg == pytest.approx(1.0)
    assert band(far).p90_deg == pytest.approx(1.0)


@pytest.mark.parametrize(("stated", "as_stated"), [(0.02, True), (0.013, False), (0.03, False)])
def test_errors_that_are_as_stated_are_told_from_such_that_are_not(stated: float, *, as_stated: bool) -> None:
    truth, rng = truth_of(), np.random.default_rng(5)
    directions = off_by(truth, rng.normal(0.0, 0.02, COUNT), rng.normal(0.0, 0.02, COUNT))
    found = band(scored(truth, Answered(answer="answered", directions=directions, covariance=round_sigma(stated))))
    assert [found.as_stated(k) for k in range(3)] == [as_stated] * 3


def test_an_ellipse_is_judged_along_its_own_axes() -> None:
    truth, rng = truth_of(), np.random.default_rng(6)
    root = np.array([[0.05, 0.0], [0.03, 0.01]])
    drawn = rng.normal(size=(COUNT, 2)) @ root.T
    directions = off_by(truth, drawn[:, 0], drawn[:, 1])
    ellipse = np.tile(root @ root.T, (COUNT, 1, 1))
    right = band(scored(truth, Answered(answer="answered", directions=directions, covariance=ellipse)))
    turned = ellipse * np.array([[1.0, -1.0], [-1.0, 1.0]])
    wrong = band(scored(truth, Answered(answer="answered", directions=directions, covariance=turned)))
    assert right.as_stated(0)
    assert right.as_stated(2)
    assert not wrong.as_stated(2)


def test_errors_that_are_not_gaussian_may_be_stated() -> None:
    truth, rng = truth_of(), np.random.default_rng(7)
    directions = off_by(truth, rng.normal(0.0, 0.02, COUNT), rng.normal(0.0, 0.02, COUNT))
    scales = np.tile([2.0, 2.0, 2.0], (COUNT, 1))
    half = Answered(answer="answered", directions=directions, covariance=round_sigma(0.01), scales=scales)
    assert band(scored(truth, half)).as_stated(2)
    assert not band(scored(truth, replace(half, scales=None))).as_stated(2)


def test_a_refusal_costs_the_fallback_and_is_right_only_where_nothing_can_be_said() -> None:
    nothing = Answered(answer="refused", directions=np.full((COUNT, 3), np.nan))
    wrongly, rightly = scored(truth_of(), nothing), scored(truth_of(answerable=False), nothing)
    assert band(wrongly).median_deg == pytest.approx(4.0)
    assert band(wrongly).median_px == pytest.approx(40.0)
    assert (wrongly.refused_wrongly, wrongly.refused_rightly, wrongly.lost, wrongly.wrong) == (1, 0, 0, 0)
    assert (rightly.refused_wrongly, rightly.refused_rightly) == (0, 1)


@pytest.mark.parametrize(("sigmas", "far"), [(2.9, 0), (3.1, 1)])
def test_an_answer_further_off_than_it_states_is_counted(sigmas: float, far: int) -> None:
    truth, median = truth_of(), math.sqrt(2.0 * math.log(2.0))
    answered = Answered(answer="answered", directions=off_by(truth, 0.1 * sigmas * median), covariance=round_sigma(0.1))
    assert scored(truth, answered).far == far
    assert scored(truth, replace(answered, covariance=None)).far == 0


@pytest.mark.parametrize(("error", "wrong"), [(3.9, 0), (4.1, 1)])
def test_an_answer_worse_than_none_is_counted(error: float, wrong: int) -> None:
    truth = truth_of()
    assert scored(truth, Answered(answer="answered", directions=off_by(truth, error))).wrong == wrong


def test_a_case_that_is_not_answered_is_lost() -> None:
    found = score("entrant", {"s000": truth_of()}, {})
    assert (found.lost, codes(found)) == (1, ["benchmark_case_missing"])
    assert band(found).median_deg == pytest.approx(4.0)


def write_table(path: Path, rows: list[dict[str, object]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


Rows = list[dict[str, object]]


def with_nan(rows: Rows) -> Rows:
    return [{**row, "zenith_deg": "nan"} if k < 10 else row for k, row in enumerate(rows)]


def with_text(rows: Rows) -> Rows:
    return [{**row, "azimuth_deg": "north"} if k < 10 else row for k, row in enumerate(rows)]


def infinite(rows: Rows) -> Rows:
    return [{**row, "zenith_deg": "inf", "azimuth_deg": "1e400"} if k < 10 else row for k, row in enumerate(rows)]


def impossible(rows: Rows) -> Rows:
    stated = {"sigma_zenith_deg": 1.0, "sigma_azimuth_deg": 1.0}
    return [{**row, **stated, "correlation": 2.0 if k < 10 else 0.0} for k, row in enumerate(rows)]


def infinite_sigma(rows: Rows) -> Rows:
    return [{**row, "sigma_deg": "inf" if k < 10 else 1.0} for k, row in enumerate(rows)]


def zero_scale(rows: Rows) -> Rows:
    scales = {"scale_50": 1.0, "scale_68": 1.0}
    return [{**row, "sigma_deg": 1.0, **scales, "scale_95": 0.0 if k < 10 else 1.0} for k, row in enumerate(rows)]


def fewer(rows: Rows) -> Rows:
    return rows[10:]


def backwards(rows: Rows) -> Rows:
    return rows[::-1]


def repeated(rows: Rows) -> Rows:
    return [*rows, *({**row, "zenith_deg": 10.0} for row in rows[:10])]


def unknown(rows: Rows) -> Rows:
    return [*rows, {**rows[0], "x_px": -50.0}]


def zero_sigma(rows: Rows) -> Rows:
    return [{**row, "sigma_deg": 0.0} for row in rows]


def no_sigma(rows: Rows) -> Rows:
    return [{**row, "sigma_deg": -1.0 if k < 10 else 1.0} for k, row in enumerate(rows)]


@pytest.mark.parametrize(
    ("change", "code", "lost", "within"),
    [
        (with_nan, "benchmark_rows_undefined", 10, math.nan),
        (with_text, "benchmark_rows_undefined", 10, math.nan),
        (infinite, "benchmark_rows_undefined", 10, math.nan),
        (impossible, "benchmark_sigma_undefined", 0, 0.8),
        (infinite_sigma, "benchmark_sigma_undefined", 0, 0.8),
        (zero_scale, "benchmark_sigma_zero", 0, 0.8),
        (fewer, "benchmark_rows_missing", 10, math.nan),
        (backwards, "benchmark_rows_reordered", 0, math.nan),
        (repeated, "benchmark_rows_repeated", 0, math.nan),
        (unknown, "benchmark_rows_unknown", 0, math.nan),
        (zero_sigma, "benchmark_sigma_zero", 0, 0.0),
        (no_sigma, "benchmark_sigma_undefined", 0, 0.8),
        (list, None, 0, math.nan),
    ],
)
def test_a_wrong_entry_is_scored_as_what_it_is(
    tmp_path: Path, change: Callable[[Rows], Rows], code: str | None, lost: int, within: float
) -> None:
    truth = truth_of(50)
    zenith, azimuth = angles_from_direction(off_by(truth, 0.1))
    columns = zip(*truth.pixels.T.tolist(), zenith.tolist(), azimuth.tolist(), strict=True)
    rows: Rows = [dict(zip(("x_px", "y_px", "zenith_deg", "azimuth_deg"), row, strict=True)) for row in columns]
    write_table(tmp_path / "s000.csv", change(rows))
    found = score("entrant", {"s000": truth}, read_entry(tmp_path, {"s000": truth}))
    assert codes(found) == ([] if code is None else [code])
    assert all("{" not in finding.text for finding in found.findings)
    everything = band(found)
    assert everything.median_deg == pytest.approx(0.1, abs=1e-6)
    assert (everything.p90_deg > 1.0) == (lost > 0)
    assert everything.within[2] == pytest.approx(within, nan_ok=True)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("s000.csv", b"x_px,y_px,zenith_deg\n1,2,3\n"),
        ("s000.csv", b"\xff\xfe\x00"),
        ("s000.csv", b""),
        ("s000.json", b"{"),
        ("s000.json", b"[" * 100_000),
        ("s000.json", b'{"model": 3}'),
        ("s000.json", b"[]"),
    ],
)
def test_a_file_that_cannot_be_read_is_a_lost_case(tmp_path: Path, name: str, content: bytes) -> None:
    truth = truth_of(50)
    (tmp_path / name).write_bytes(content)
    found = score("entrant", {"s000": truth}, read_entry(tmp_path, {"s000": truth}))
    assert (found.lost, codes(found)) == (1, ["benchmark_entry_unreadable"])


def test_an_answer_to_another_case_is_said_and_not_scored(tmp_path: Path) -> None:
    (tmp_path / "s777.csv").write_text("x_px,y_px,zenith_deg,azimuth_deg\n")
    (tmp_path / "cases.csv").write_text("case,status\ns000,refused\n")
    found = score("entrant", {"s000": truth_of(9)}, read_entry(tmp_path, {"s000": truth_of(9)}))
    assert codes(found) == ["benchmark_case_unknown"]
    assert (found.refused_wrongly, found.lost) == (1, 0)


def test_no_entry_is_an_error_of_the_caller(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        read_entry(tmp_path / "none", {})
    with pytest.raises(InputError):
        read_round(tmp_path)


def test_the_numbers_of_cases_have_every_lens_in_every_condition() -> None:
    pairs = {(number % len(LENSES), number % len(CONDITIONS)) for number in range(len(LENSES) * len(CONDITIONS))}
    assert len(pairs) == len(LENSES) * len(CONDITIONS)


@pytest.mark.parametrize("number", range(len(LENSES)))
def test_a_truth_has_the_slopes_of_its_own_pixels(number: int) -> None:
    case, truth = benchmark_case(number, seed=11, night=False)
    assert truth.lens == LENSES[number]
    assert len(truth.pixels) > 100
    # the nearest two queries: the change of the pixel is about the slope times that of the direction
    cosines = truth.directions @ truth.directions.T - 2.0 * np.eye(len(truth.pixels))
    cosines[truth.directions[:, 2] < 0.5] = -2.0
    i, j = np.unravel_index(np.argmax(cosines), cosines.shape)
    middle = replace(truth, directions=truth.directions[[i]])
    change = truth.directions[j] - truth.directions[i]
    tangent = np.degrees([float(np.sum(change * side)) for side in neighbouring_directions(middle.directions)])
    shift = truth.pixels[j] - truth.pixels[i]
    assert np.linalg.norm(shift - truth.px_per_deg[i] @ tangent) < 0.1 * np.linalg.norm(shift)
    assert len(case.apparent) == len(case.sightings)


def test_a_round_is_read_as_it_was_written_and_made_again_by_its_seed(tmp_path: Path) -> None:
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        write_round([benchmark_case(0, seed=seed, night=True)], folder=tmp_path / name, part="night", seed=seed)
    hashes = [truth_hash(tmp_path / name / "truth") for name in "abc"]
    assert hashes[0] == hashes[1] != hashes[2]
    names, published = read_round(tmp_path / "a" / "cases")
    assert (names, published) == (["n000"], hashes[0])
    read, (made_case, truth) = read_case(tmp_path / "a" / "cases" / "n000"), benchmark_case(0, seed=5, night=True)
    assert np.allclose(read.sightings.pixels, made_case.sightings.pixels, atol=1e-6)
    assert np.array_equal(read.sightings.body, made_case.sightings.body)
    assert np.allclose(read.sightings.unix_s, made_case.sightings.unix_s, atol=1e-3)
    assert np.allclose(read.apparent, made_case.apparent, atol=1e-7)
    assert (read.projection, read.image_size) == (made_case.projection, made_case.image_size)
    stored = read_truth(tmp_path / "a" / "truth")["n000"]
    assert np.allclose(stored.px_per_deg, truth.px_per_deg, atol=1e-6)
    assert np.allclose(stored.directions, truth.directions, atol=1e-7)


def test_what_an_entrant_gets_does_not_hold_the_truth(tmp_path: Path) -> None:
    write_round([benchmark_case(6, seed=5, night=False)], folder=tmp_path, part="simulated", seed=5)
    given = sorted(path.name for path in (tmp_path / "cases").rglob("*.*"))
    assert given == ["benchmark.json", "case.json", "queries.csv", "sightings.csv"]
    listed = json.loads((tmp_path / "cases" / "benchmark.json").read_text())
    assert set(listed) == {"format", "part", "truth_sha256", "cases"}
    facts = json.loads((tmp_path / "cases" / "s006" / "case.json").read_text())
    assert set(facts) == {"case", "part", "latitude", "longitude", "altitude", "width", "height", "projection"}


def test_the_command_makes_runs_and_scores_a_round(tmp_path: Path, sunarc: Sunarc) -> None:
    folder, entry = tmp_path / "round", tmp_path / "ours"
    assert sunarc("study", "benchmark", "make", "--cases", "1", "--seed", "7", "-o", str(folder)).code == 0
    assert sunarc("study", "benchmark", "run", str(folder / "cases"), "-o", str(entry)).code == 0
    scoring = ("study", "benchmark", "score", str(folder / "cases"), str(entry), "--truth", str(folder / "truth"))
    answer = sunarc(*scoring, "--json")
    (ours,) = json.loads(answer.out)["entrants"]
    assert (ours["answerable"], ours["refused_wrongly"], ours["lost"], ours["findings"]) == (1, 0, 0, [])
    assert ours["bands"][-1]["median_deg"] < 0.05
    # a document is scored as the table of its directions is
    case = read_case(folder / "cases" / "s000")
    table = read_entry(entry, read_truth(folder / "truth"))["s000"]
    direct = collect_answers(calibrate_case(case, "robust"), case.queries)
    assert np.allclose(table.directions, direct.directions, atol=1e-7)
    assert table.covariance is not None
    assert direct.covariance is not None
    assert np.allclose(table.covariance, direct.covariance, atol=2e-6)
    truth = folder / "truth" / "s000.csv"
    truth.write_text(truth.read_text().replace("1", "2"))
    changed = json.loads(sunarc(*scoring, "--json").out)["entrants"][0]
    assert changed["findings"][0]["code"] == "benchmark_truth_differs"


@pytest.mark.parametrize("seed", ["one", "-1", "1.5"])
def test_a_seed_that_is_no_number_is_refused(tmp_path: Path, sunarc: Sunarc, seed: str) -> None:
    assert sunarc("study", "benchmark", "make", "--seed", seed, "-o", str(tmp_path)).code == 2


def test_a_search_that_tries_a_camera_far_off_ends_with_a_verdict(tmp_path: Path) -> None:
    # days left out of such a fit had a negative variance: the fit ended with an error
    (tmp_path / "truth").mkdir()
    name, _ = made(28, 20261125, tmp_path / "cases", tmp_path / "truth")
    assert calibrate_case(read_case(tmp_path / "cases" / name), "robust").verdict.findings


def test_the_second_generator_shares_no_code_with_the_package(tmp_path: Path) -> None:
    for name in ("benchmark_second", "independent_world"):
        tree = ast.parse((STUDIES / f"{name}.py").read_text())
        imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names} | {
            node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)
        }
        assert not [one for one in imported if one.startswith("sunarc")]
    (tmp_path / "truth").mkdir()
    name, about = made(1, 4, tmp_path / "cases", tmp_path / "truth")
    assert about["lens"] == SECOND_LENSES[1]
    (tmp_path / "truth" / "benchmark.json").write_text(json.dumps({"cases": {name: about}}))
    truth = read_truth(tmp_path / "truth")[name]
    case = read_case(tmp_path / "cases" / name)
    found = score("ours", {name: truth}, {name: collect_answers(calibrate_case(case, "robust"), case.queries)})
    assert (found.lost, found.refused_wrongly, found.wrong) == (0, 0, 0)
    assert band(found).median_deg < 0.1
