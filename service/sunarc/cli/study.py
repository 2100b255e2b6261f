"""`sunarc study`: parse, run, write, print."""

from __future__ import annotations

import itertools
import secrets
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar, get_args

import typer
from rich.console import Console
from rich.table import Table

from sunarc.calibration.model.options import Method
from sunarc.cli.options import AsJson, parse_choice, print_json, progress_bars
from sunarc.cli.owner import act_as_folder_owner
from sunarc.common.errors import InputError, disk_errors
from sunarc.common.extras import extra_module
from sunarc.common.findings import Finding
from sunarc.lab.studies.published import CASES
from sunarc.lab.studies.reports import make_folder, write_shadow, write_tables, write_uncertainty
from sunarc.lab.studies.shadow import SIGMAS_DEG, WIND_M_S, study_calibrated_shadow, study_shadow
from sunarc.lab.studies.tables import study_tables
from sunarc.lab.studies.uncertainty import distribution_rows, study_uncertainty
from sunarc.public.calibration_files import read_calibration

if TYPE_CHECKING:
    from sunarc.lab.studies.benchmark_cases import BenchmarkCase
    from sunarc.lab.studies.benchmark_scores import Answered

AnyValue = TypeVar("AnyValue")

benchmark_cli = typer.Typer(no_args_is_help=True, help="An open benchmark of calibrations: docs/benchmark/README.md.")
study_cli = typer.Typer(no_args_is_help=True, help="Reproduce the paper's tables and figures; errors of cloud shadows.")

study_cli.add_typer(benchmark_cli, name="benchmark")

AnyRow = Mapping[str, str | int | float]

Out = Annotated[Path, typer.Option("--out", callback=act_as_folder_owner, help="Folder for the CSV and PNG files.")]
Methods = Annotated[str, typer.Option("--method", help="paper, robust or both.")]
Seed = Annotated[int, typer.Option(help="Of everything that is drawn.", min=0)]

Sheet = dict[str, str]
"""Columns of a printed table: the heading, and the key in a row."""

_ERRORS: Sheet = {
    "case": "case", "source": "source", "n": "n", "RMSE": "rmse_px", "MAE": "mae_px", "SD": "sd_of_distance_px",
    "SD27c": "sd_px", "RMSDm": "rmsd_m_px", "SDm": "sd_m_px", "arc": "true_arc_rmse_px", "sky": "true_sky_rmse_px",
}  # fmt: skip
_CAMERAS: Sheet = {
    "case": "case", "source": "source", "αx": "focal_length_x_px", "αy": "focal_length_y_px", "s": "skew_px",
    "x0": "principal_point_x_px", "y0": "principal_point_y_px",
    "φxz": "phi_xz_deg", "θzz": "theta_zz_deg", "ψz": "psi_z_deg",
}  # fmt: skip
_UNCERTAINTY: Sheet = {
    "method": "method", "σ": "sigma_px", "quantity": "quantity", "mean": "mean", "5 %": "p05", "median": "median",
    "95 %": "p95", "bound": "bound",
}  # fmt: skip
_SHADOW: Sheet = {
    "σ, °": "sigma_deg", "base, m": "height_m", "σ height, m": "height_sigma_m", "σ shadow, m": "shadow_pair_sigma_m",
    "height known, m": "shadow_sigma_m", "ramp, W/m²": "ramp_error_w_m2",
}  # fmt: skip
_SHOWN_LEVELS = 5


@study_cli.command()
def uncertainty(
    *,
    out: Out,
    trials: Annotated[int, typer.Option(help="Fits at each level; the paper made 1000.", min=1)] = 25,
    levels: Annotated[int, typer.Option(help="Noise levels from 0 to 10 px.", min=2)] = 41,
    seed: Seed = 1,
    method: Methods = "both",
    jobs: Annotated[int, typer.Option(help="Processes.", min=1)] = 1,
    as_json: AsJson = False,
) -> None:
    """Make Figures 4 and 5 again: noise of the sightings, error of the calibration.

    Example: sunarc study uncertainty --trials 5 --levels 11 --out study
    """
    methods = _parse_methods(method)
    extra_module("matplotlib", extra="plots")  # before the fits, which take minutes
    make_folder(out)
    with _show_progress("fits", len(methods) * levels * trials) as advance:
        study = study_uncertainty(
            methods=methods, levels=levels, trials=trials, seed=seed, jobs=jobs, after_each=advance
        )
    files = write_uncertainty(study, folder=out)
    rows = distribution_rows(study)
    shown = {float(study.sigma_px[i * (levels - 1) // (_SHOWN_LEVELS - 1)]) for i in range(_SHOWN_LEVELS)}
    errors = [row for row in rows if row["sigma_px"] in shown and str(row["quantity"]).endswith("rmse_px")]
    sheets = {"true errors of the calibration, px": (_UNCERTAINTY, errors)}
    _print_tables(rows, sheets, files=files, as_json=as_json)


@study_cli.command()
def tables(*, out: Out, seed: Seed = 1, method: Methods = "both", as_json: AsJson = False) -> None:
    """Make Tables 1 to 3 again: the paper's five cases, simulated.

    Example: sunarc study tables --out study
    """
    methods = _parse_methods(method)
    make_folder(out)
    with _show_progress("fits", len(methods) * len(CASES)) as advance:
        rows = study_tables(methods=methods, seed=seed, after_each=advance)
    sheets = {
        "Tables 1 and 3, and the true error on the arc and over the sky, px": (_ERRORS, rows),
        "Table 2, px and degrees": (_CAMERAS, rows),
    }
    _print_tables(rows, sheets, files=write_tables(rows, folder=out), as_json=as_json)


@study_cli.command()
def shadow(
    *,
    out: Out,
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="Document whose stated errors are taken, in place of turns.")
    ] = None,
    draws: Annotated[int, typer.Option(help="Pairs of cameras that are drawn.", min=10, max=20_000)] = 1000,
    seed: Seed = 1,
    as_json: AsJson = False,
) -> None:
    """From an error of the direction to the cloud base height, its shadow and a ramp of the irradiance.

    Example: sunarc study shadow --out study
    """
    extra_module("matplotlib", extra="plots")
    make_folder(out)
    if calibration is None:
        with _show_progress("sizes", len(SIGMAS_DEG)) as advance:
            rows = study_shadow(draws=draws, seed=seed, after_each=advance)
    else:
        rows = study_calibrated_shadow(read_calibration(calibration), draws=draws, seed=seed)
    table = [asdict(row) for row in rows]
    shown = [row for row in table if row["baseline_m"] == 1000.0 and row["height_m"] in {1000.0, 2000.0}]
    sheets = {f"cloud at {WIND_M_S:g} m/s, cameras 1000 m apart; all rows in shadow.csv": (_SHADOW, shown)}
    _print_tables(table, sheets, files=write_shadow(rows, folder=out), as_json=as_json)


@benchmark_cli.command()
def make(
    *,
    out: Annotated[
        Path, typer.Option("--out", "-o", callback=act_as_folder_owner, help="Folder for `cases/` and `truth/`.")
    ],
    part: Annotated[str, typer.Option(help="simulated, or night: with stars.")] = "simulated",
    cases: Annotated[int, typer.Option(help="How many.", min=1, max=1000)] = 60,
    first: Annotated[int, typer.Option(help="Number of the first.", min=0)] = 0,
    seed: Annotated[
        str, typer.Option(help="A whole number; new: one that nobody can guess, for a ranked round.")
    ] = "1",
    as_json: AsJson = False,
) -> None:
    """Make a round: cases for entrants, and the truth, whose hash stands among the cases.

    Example: sunarc study benchmark make --cases 12 --seed 7 -o round
    """
    from sunarc.lab.studies.benchmark_cases import benchmark_cases
    from sunarc.lab.studies.benchmark_files import write_round

    night = parse_choice("--part", part, ("simulated", "night")) == "night"
    if seed != "new" and not seed.isdecimal():
        raise InputError(field="--seed", problem=f"{seed!r} is no whole number", remedy="give one, or new")
    number = secrets.randbits(128) if seed == "new" else int(seed)
    with _show_progress("cases", cases) as advance:
        drawn = _report_each(benchmark_cases(cases, seed=number, night=night, first=first), advance)
        count, digest = write_round(drawn, folder=out, part=part, seed=number)
    facts = {"cases": count, "truth_sha256": digest, "folder": str(out)}
    if as_json:
        print_json(facts)
    else:
        print(f"{count} cases in {out / 'cases'}, their truth in {out / 'truth'}, SHA-256 {digest}")


@benchmark_cli.command()
def run(
    cases: Annotated[Path, typer.Argument(help="The folder `cases/` of a round.")],
    *,
    out: Annotated[Path, typer.Option("--out", "-o", callback=act_as_folder_owner, help="Folder for the entry.")],
    method: Annotated[str, typer.Option("--method", help="paper or robust.")] = "robust",
    as_json: AsJson = False,
) -> None:
    """Enter sunarc itself: calibrate every case as `sunarc calibrate` would.

    Example: sunarc study benchmark run round/cases -o entries/sunarc
    """
    from sunarc.lab.studies.benchmark_files import read_case, read_round, write_entry
    from sunarc.lab.studies.benchmark_scores import calibrate_case, collect_answers

    chosen, names = parse_choice("--method", method, get_args(Method)), read_round(cases)[0]

    def answered(name: str) -> tuple[BenchmarkCase, Answered]:
        case, begin = read_case(cases / name), time.process_time()
        given = collect_answers(calibrate_case(case, chosen), case.queries)
        return case, replace(given, processor_s=time.process_time() - begin)

    with _show_progress("cases", len(names)) as advance:
        count = write_entry(_report_each(map(answered, names), advance), folder=out)
    if as_json:
        print_json({"cases": count, "folder": str(out)})
    else:
        print(f"{count} cases in {out}")


@benchmark_cli.command(name="score")
def score_entries(
    cases: Annotated[Path, typer.Argument(help="The folder `cases/` of a round.")],
    entries: Annotated[list[Path], typer.Argument(help="Folders of entries; an entrant is called as its folder.")],
    *,
    truth: Annotated[Path, typer.Option("--truth", help="The folder `truth/` of the round.")],
    out: Annotated[
        Path | None, typer.Option("--out", callback=act_as_folder_owner, help="File for the tables, in Markdown.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Score entries against the truth; a wrong entry is scored as it stands, with a finding.

    Example: sunarc study benchmark score round/cases entries/sunarc --truth round/truth
    """
    from sunarc.lab.studies.benchmark_files import read_entry, read_round, read_truth, truth_hash
    from sunarc.lab.studies.benchmark_scores import as_object, render_tables, score

    truths, published = read_truth(truth), read_round(cases)[1]
    scores = [score(entry.resolve().name, truths, read_entry(entry, truths)) for entry in entries]
    if truth_hash(truth) != published:
        differs = Finding("benchmark_truth_differs")
        scores = [replace(one, findings=(differs, *one.findings)) for one in scores]
    text = render_tables(scores)
    if out is not None:
        with disk_errors(out):
            out.write_text(text, encoding="utf-8")
    if as_json:
        print_json({"entrants": [as_object(one) for one in scores]})
        return
    print(text)
    for one in scores:
        for finding in one.findings:
            print(f"{one.entrant}: {finding.text} [{finding.code}]")


def _report_each(values: Iterable[AnyValue], advance: Callable[[], None]) -> Iterator[AnyValue]:
    """Yield values, and say when each is done with."""
    for value in values:
        yield value
        advance()


def _parse_methods(text: str) -> tuple[Method, ...]:
    known: tuple[Literal["paper", "robust"], ...] = ("paper", "robust")
    if text == "both":
        return known
    for method in known:
        if method == text:
            return (method,)
    raise InputError(
        field="--method", problem=f"{text!r} is unknown", remedy=f"use one of {', '.join(get_args(Method))}, both"
    )


@contextmanager
def _show_progress(what: str, total: int) -> Iterator[Callable[[], None]]:
    """Show a bar; give the function that moves it on by one."""
    done = itertools.count(1)
    with progress_bars() as bars:
        bars(what, 0, total)
        yield lambda: bars(what, next(done), total)


def _print_tables(
    rows: Sequence[AnyRow],
    sheets: Mapping[str, tuple[Sheet, Sequence[AnyRow]]],
    *,
    files: Sequence[Path],
    as_json: bool,
) -> None:
    if as_json:
        print_json({"rows": list(rows), "files": [str(file) for file in files]})
        return
    console = Console(soft_wrap=True, highlight=False)
    for title, (columns, shown) in sheets.items():
        table = Table(title=title, title_justify="left", box=None, pad_edge=False)
        for column in columns:
            table.add_column(
                column, no_wrap=True, justify="left" if column in {"source", "method", "quantity"} else "right"
            )
        for row in shown:
            table.add_row(*(_format_cell(row.get(name, "")) for name in columns.values()))
        console.print(table)
    for file in files:
        console.print(f"written: {file}")


def _format_cell(value: str | float) -> str:
    if not isinstance(value, float):
        return str(value)
    return f"{value:.2f}" if abs(value) >= 10.0 else f"{value:.3g}"
