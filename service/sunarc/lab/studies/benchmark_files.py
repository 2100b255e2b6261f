"""Files of the benchmark: a round's cases and its truth, and an entry, which may be wrong in any way."""

from __future__ import annotations

import csv
import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from io import TextIOWrapper
from pathlib import Path
from typing import Any

import numpy as np

from sunarc.calibration.model.sightings import Sightings
from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError, disk_errors
from sunarc.common.findings import Finding
from sunarc.common.foreign_files import open_regular, read_regular
from sunarc.common.utc import parse_time, rfc3339, utc_time
from sunarc.formats.calibration_document import from_document
from sunarc.lab.studies.benchmark_cases import BenchmarkCase, BenchmarkTruth
from sunarc.lab.studies.benchmark_scores import SHARES, Answered, collect_answers
from sunarc.sky.directions import angles_from_direction, direction_from_angles
from sunarc.sky.night import SUN
from sunarc.sky.site import Site

FORMAT = 1
_ROUND = "benchmark.json"
_STATED = "cases.csv"
_QUERY = ("x_px", "y_px")
_ANGLES = ("zenith_deg", "azimuth_deg")
_TRUE = (*_QUERY, *_ANGLES, "track_deg", "dx_dzenith", "dy_dzenith", "dx_dazimuth", "dy_dazimuth", "fallback_deg")
_SEEN = ("time_utc", *_QUERY, "sigma_px", "body", *_ANGLES, "apparent_zenith_deg", "apparent_azimuth_deg")
_SCALES = tuple(f"scale_{100.0 * share:.0f}" for share in SHARES)
_ERRORS = ("sigma_zenith_deg", "sigma_azimuth_deg", "correlation")
_SAME_PX = 2e-3
"""Pixels that differ by less are one."""


def write_round(
    cases: Iterable[tuple[BenchmarkCase, BenchmarkTruth]], *, folder: Path, part: str, seed: int
) -> tuple[int, str]:
    """Write `cases/`, which an entrant is given, and `truth/`, which is withheld; return how many, and the hash.

    Raises
    ------
    OutsideError
        Where the disk refuses.
    """
    given, withheld = folder / "cases", folder / "truth"
    about: dict[str, dict[str, Any]] = {}
    with disk_errors(folder):
        withheld.mkdir(parents=True, exist_ok=True)
        for case, truth in cases:
            _write_case(given / case.name, case, part)
            zenith, azimuth = angles_from_direction(truth.directions)
            slopes = np.swapaxes(truth.px_per_deg, -1, -2).reshape(-1, 4)
            columns = np.column_stack([truth.pixels, zenith, azimuth, truth.track_deg, slopes, truth.fallback_deg])
            _write_rows(withheld / f"{case.name}.csv", _TRUE, columns)
            about[case.name] = {"lens": truth.lens, "condition": truth.condition, "answerable": truth.answerable}
        _write_json(withheld / _ROUND, {"format": FORMAT, "part": part, "seed": str(seed), "cases": about})
        digest = truth_hash(withheld)
        _write_json(given / _ROUND, {"format": FORMAT, "part": part, "truth_sha256": digest, "cases": list(about)})
    return len(about), digest


def truth_hash(folder: Path) -> str:
    """Return the SHA-256 of a truth: of the names and contents of its files, in the order of the names."""
    digest = hashlib.sha256()
    for path in sorted(folder.iterdir()):
        if path.suffix in {".csv", ".json"}:
            digest.update(path.name.encode() + b"\0" + read_regular(path) + b"\0")
    return digest.hexdigest()


def _write_case(folder: Path, case: BenchmarkCase, part: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    site, (width, height) = case.site, case.image_size
    place = {"latitude": site.latitude, "longitude": site.longitude, "altitude": site.altitude}
    facts = {"case": case.name, "part": part, **place, "width": width, "height": height}
    _write_json(folder / "case.json", {**facts, "projection": case.projection})
    _write_rows(folder / "queries.csv", _QUERY, case.queries)
    seen = case.sightings
    stated = np.column_stack(angles_from_direction(seen.directions))
    apparent = np.column_stack(angles_from_direction(case.apparent))
    with (folder / "sightings.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(_SEEN)
        for k, body in enumerate(seen.body.tolist()):
            time = rfc3339(utc_time(float(seen.unix_s[k])), timespec="milliseconds")
            angles = [_format_cell(value) for value in stated[k]] if body != SUN else ["", ""]
            cells = [*(_format_cell(value) for value in seen.pixels[k]), _format_cell(seen.sigma_px[k]), body, *angles]
            writer.writerow([time, *cells, *(_format_cell(value) for value in apparent[k])])


def _write_rows(path: Path, columns: Sequence[str], rows: FloatArray) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows([_format_cell(value) for value in row] for row in rows)


def _format_cell(value: float) -> str:
    return f"{value:.6f}" if math.isfinite(value) else ""


def _write_json(path: Path, value: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def read_round(folder: Path) -> tuple[list[str], str]:
    """Return the names of a round's cases, and the hash of its truth.

    Raises
    ------
    InputError
        Where the folder has no round that can be read.
    """
    stated = _read_json_object(folder / _ROUND)
    cases = stated.get("cases")
    if stated.get("format") != FORMAT or not isinstance(cases, list):
        raise InputError(field=str(folder / _ROUND), problem="not a round of format 1", remedy="make one")
    return [str(name) for name in cases], str(stated.get("truth_sha256", ""))


def read_case(folder: Path) -> BenchmarkCase:
    """Return a case as an entrant is given it.

    Raises
    ------
    InputError
        Where a file is missing or damaged.
    """
    facts = _read_json_object(folder / "case.json")
    rows = list(_read_table_rows(folder / "sightings.csv", _SEEN))
    asked = _read_number_columns(folder / "queries.csv", _QUERY)
    try:
        site = Site(latitude=facts["latitude"], longitude=facts["longitude"], altitude=facts["altitude"])
        columns = np.array(
            [[_parse_number(row[name]) for name in _SEEN if name not in {"time_utc", "body"}] for row in rows]
        )
        columns = columns.reshape(-1, 7)
        return BenchmarkCase(
            name=str(facts["case"]),
            site=site,
            image_size=(int(facts["width"]), int(facts["height"])),
            projection=facts["projection"],
            sightings=Sightings.of(
                unix_s=[parse_time(row["time_utc"], where=str(folder)).timestamp() for row in rows],
                pixels=columns[:, :2],
                sigma_px=columns[:, 2],
                directions=direction_from_angles(zenith_deg=columns[:, 3], azimuth_deg=columns[:, 4]),
                body=np.array([row["body"] for row in rows], dtype=np.str_),
            ),
            apparent=direction_from_angles(zenith_deg=columns[:, 5], azimuth_deg=columns[:, 6]),
            queries=asked,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(field=str(folder), problem=f"not a case: {error}", remedy="make the round again") from error


def read_truth(folder: Path) -> dict[str, BenchmarkTruth]:
    """Return the truth of a round, by case.

    Raises
    ------
    InputError
        Where a file is missing or damaged.
    """
    truths = {}
    for name, about in dict(_read_json_object(folder / _ROUND).get("cases", {})).items():
        columns = _read_number_columns(folder / f"{name}.csv", _TRUE)
        truths[str(name)] = BenchmarkTruth(
            lens=str(about["lens"]),
            condition=str(about["condition"]),
            answerable=bool(about["answerable"]),
            pixels=columns[:, :2],
            directions=direction_from_angles(zenith_deg=columns[:, 2], azimuth_deg=columns[:, 3]),
            track_deg=columns[:, 4],
            px_per_deg=np.swapaxes(columns[:, 5:9].reshape(-1, 2, 2), -1, -2),
            fallback_deg=columns[:, 9],
        )
    return truths


def read_entry(folder: Path, truths: Mapping[str, BenchmarkTruth]) -> dict[str, Answered]:
    """Return an entrant's answers by case; one that cannot be read is a lost case with a finding.

    Raises
    ------
    InputError
        Where there is no such folder.
    """
    if not folder.is_dir():
        raise InputError(field=str(folder), problem="not a folder", remedy="name the folder of an entry")
    stated = _read_statements(folder / _STATED)
    files = {path.stem: path for path in sorted(folder.glob("*.csv")) if path.name != _STATED}
    files |= {path.stem: path for path in sorted(folder.glob("*.json")) if path.name != "entry.json"}
    answers: dict[str, Answered] = {}
    for name in sorted({*files, *stated}):
        status, seconds = stated.get(name, ("answered", math.nan))
        truth = truths.get(name)
        nothing = np.full((0 if truth is None else len(truth.pixels), 3), np.nan)
        if truth is None or status == "refused":
            answers[name] = Answered(answer="refused", directions=nothing, processor_s=seconds)
        elif name not in files:
            if status == "failed":
                found = Finding("benchmark_entry_unreadable", {"case": name, "problem": "the entrant failed"})
                answers[name] = Answered(answer="failed", directions=nothing, processor_s=seconds, findings=(found,))
        else:
            answers[name] = _read_answer(name, files[name], truth, seconds)
    return answers


def write_entry(answers: Iterable[tuple[BenchmarkCase, Answered]], *, folder: Path) -> int:
    """Write an entry, a table of directions a case, as `read_entry` reads it, and return how many cases.

    Raises
    ------
    OutsideError
        Where the disk refuses.
    """
    stated = []
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for case, given in answers:
            stated.append([case.name, given.answer, _format_cell(given.processor_s)])
            if given.answer == "answered":
                zenith, azimuth = angles_from_direction(given.directions)
                columns = np.column_stack([case.queries, zenith, azimuth])
                header: tuple[str, ...] = (*_QUERY, *_ANGLES)
                if given.covariance is not None and given.scales is not None:
                    columns = np.column_stack([columns, *_stated_errors(given.covariance), given.scales])
                    header = (*header, *_ERRORS, *_SCALES)
                _write_rows(folder / f"{case.name}.csv", header, columns)
        with (folder / _STATED).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["case", "status", "processor_s"])
            writer.writerows(stated)
    return len(stated)


def _stated_errors(covariance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return both 1-sigmas and the correlation (m,) of covariances (m, 2, 2)."""
    sigmas = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    return sigmas[:, 0], sigmas[:, 1], covariance[:, 0, 1] / (sigmas[:, 0] * sigmas[:, 1])


def _read_statements(path: Path) -> dict[str, tuple[str, float]]:
    """Return the statements of an entry about its cases: a status and the processor's time; empty without them."""
    try:
        rows = list(_read_table_rows(path, ("case", "status")))
    except InputError:
        return {}
    return {row["case"]: (row["status"].strip(), _parse_number(row.get("processor_s", ""))) for row in rows}


def _read_answer(name: str, path: Path, truth: BenchmarkTruth, seconds: float) -> Answered:
    """Return the answer in a table of directions or in a calibration document."""
    try:
        if path.suffix == ".json":
            return collect_answers(from_document(_read_json_object(path)), truth.pixels, processor_s=seconds)
        return _match_rows(name, list(_read_table_rows(path, (*_QUERY, *_ANGLES))), truth, seconds)
    except InputError as error:
        found = Finding("benchmark_entry_unreadable", {"case": name, "problem": str(error)})
        nothing = np.full((len(truth.pixels), 3), np.nan)
        return Answered(answer="failed", directions=nothing, processor_s=seconds, findings=(found,))


def _match_rows(name: str, rows: Sequence[Mapping[str, str]], truth: BenchmarkTruth, seconds: float) -> Answered:
    """Return a table's rows in the order of the queries, matched by their pixels."""
    given = np.array([[_parse_number(row[column]) for column in (*_QUERY, *_ANGLES)] for row in rows]).reshape(-1, 4)
    total, first, findings = len(truth.pixels), np.full(len(truth.pixels), -1), []
    unknown = repeated = 0
    for k, pixel in enumerate(given[:, :2]):
        distance = np.max(np.abs(truth.pixels - pixel), axis=-1)
        near = int(np.argmin(np.where(np.isfinite(distance), distance, np.inf)))
        if not distance[near] < _SAME_PX:
            unknown += 1
        elif first[near] >= 0:
            repeated += 1
        else:
            first[near] = k
    known = first >= 0
    if np.any(np.diff(first[known]) < 0):
        findings.append(Finding("benchmark_rows_reordered", {"case": name}))
    counts = {"missing": int(np.sum(~known)), "repeated": repeated, "unknown": unknown}
    findings += [
        Finding(f"benchmark_rows_{what}", {"case": name, "n": n, "of": total}) for what, n in counts.items() if n > 0
    ]
    picked = [rows[k] for k in first[known]]
    directions, covariance = np.full((total, 3), np.nan), np.full((total, 2, 2), np.nan)
    zenith, azimuth = given[first[known], 2], given[first[known], 3]
    directions[known] = direction_from_angles(zenith_deg=zenith, azimuth_deg=azimuth)
    errors, scales = _read_covariances(picked), np.ones((total, len(SHARES)))
    if errors is not None:
        covariance[known] = errors
    if picked and all(column in picked[0] for column in _SCALES):
        scales[known] = [[_parse_number(row[column]) for column in _SCALES] for row in picked]
    return Answered(
        answer="answered",
        directions=directions,
        covariance=None if errors is None else covariance,
        scales=scales,
        processor_s=seconds,
        findings=tuple(findings),
    )


def _read_covariances(rows: Sequence[Mapping[str, str]]) -> FloatArray | None:
    """Return the stated covariances (n, 2, 2), deg²; None where the table has no columns of them."""
    if not rows:
        return None
    if {"sigma_zenith_deg", "sigma_azimuth_deg"} <= set(rows[0]):
        across = np.array([[_parse_number(row[f"sigma_{axis}_deg"]) for axis in ("zenith", "azimuth")] for row in rows])
        correlation = np.array([_parse_number(row.get("correlation") or "0") for row in rows])
    elif "sigma_deg" in rows[0]:
        across = np.repeat([[_parse_number(row["sigma_deg"])] for row in rows], 2, axis=1)
        correlation = np.zeros(len(rows))
    else:
        return None
    across = np.where(across < 0.0, np.nan, across)
    mixed = correlation * across[:, 0] * across[:, 1]
    return np.stack([np.column_stack([across[:, 0] ** 2, mixed]), np.column_stack([mixed, across[:, 1] ** 2])], axis=1)


def _read_json_object(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(read_regular(path))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(field=str(path), problem=f"cannot be read: {error}", remedy="give a JSON file") from error
    if not isinstance(found, dict):
        raise InputError(field=str(path), problem="not a JSON object", remedy="give one")
    return found


def _read_table_rows(path: Path, required: Sequence[str]) -> Iterator[dict[str, str]]:
    """Yield the rows of a CSV file, without cells that are beyond its header."""
    try:
        with TextIOWrapper(open_regular(path), newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            missing = [name for name in required if name not in (reader.fieldnames or ())]
            if missing:
                raise InputError(field=str(path), problem=f"no column {missing[0]}", remedy="add it")
            for row in reader:
                yield {name: cell or "" for name, cell in row.items() if name is not None}
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(field=str(path), problem=f"cannot be read: {error}", remedy="give a CSV file") from error


def _read_number_columns(path: Path, columns: Sequence[str]) -> FloatArray:
    rows = [[_parse_number(row[name]) for name in columns] for row in _read_table_rows(path, columns)]
    return np.array(rows, dtype=np.float64).reshape(-1, len(columns))


def _parse_number(text: str) -> float:
    """Return a number; NaN for other values, and for an infinite one."""
    try:
        number = float(text)
    except ValueError:
        return math.nan
    return number if math.isfinite(number) else math.nan
