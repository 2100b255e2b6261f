"""Output of the studies: tables as CSV, figures as PNG. They and `benchmark_files` alone touch the disk."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from sunarc.common.extras import extra_module
from sunarc.lab.studies.shadow import ShadowRow
from sunarc.lab.studies.tables import COLUMNS, TableRow
from sunarc.lab.studies.uncertainty import UncertaintyStudy, distribution_rows, trial_rows
from sunarc.sources.files import writing_into

_DIGITS = 9


def make_folder(folder: Path) -> None:
    """Make a folder to write into, before the work begins whose result goes there."""
    with writing_into(folder):
        pass


def write_uncertainty(study: UncertaintyStudy, *, folder: Path) -> tuple[Path, ...]:
    """Write `uncertainty.csv` (distributions), `uncertainty_trials.csv` (every fit), and two figures."""
    extra_module("matplotlib", extra="plots")  # loaded when something is drawn
    from sunarc.lab.studies.figures import parameter_figure, rmse_figure  # noqa: PLC0415 - same
    from sunarc.public.plots import save_png  # noqa: PLC0415 - same

    with writing_into(folder):
        distributions, trials = distribution_rows(study), trial_rows(study)
        return (
            write_csv(folder / "uncertainty.csv", tuple(distributions[0]), distributions),
            write_csv(folder / "uncertainty_trials.csv", tuple(trials[0]), trials),
            save_png(rmse_figure(study), folder / "uncertainty_rmse.png"),
            save_png(parameter_figure(study), folder / "uncertainty_parameters.png"),
        )


def write_shadow(rows: Sequence[ShadowRow], *, folder: Path) -> tuple[Path, ...]:
    """Write `shadow.csv`, and `shadow.png` where there is more than one size of the error to draw."""
    extra_module("matplotlib", extra="plots")
    from sunarc.lab.studies.figures import shadow_figure  # noqa: PLC0415 - same
    from sunarc.public.plots import save_png  # noqa: PLC0415 - same

    with writing_into(folder):
        table = [asdict(row) for row in rows]
        files = [write_csv(folder / "shadow.csv", tuple(table[0]), table)]
        if len({row.sigma_deg for row in rows}) > 1:
            files.append(save_png(shadow_figure(rows), folder / "shadow.png"))
        return tuple(files)


def write_tables(rows: Sequence[TableRow], *, folder: Path) -> tuple[Path, ...]:
    """Write `tables.csv`."""
    with writing_into(folder):
        return (write_csv(folder / "tables.csv", COLUMNS, rows),)


def write_csv(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, str | int | float]]) -> Path:
    """Write rows as a CSV file, and return its path."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows([_format_cell(row.get(column, "")) for column in columns] for row in rows)
    return path


def _format_cell(value: str | float) -> str:
    return f"{value:.{_DIGITS}g}" if isinstance(value, float) else str(value)
