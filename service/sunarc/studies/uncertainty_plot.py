"""The paper's Figs. 4 and 5, with both methods, the whole sky, and the Cramér–Rao bound."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sunarc.calibration.options import Method
from sunarc.studies.drawing import BLUE, INK, TITLE_PT, VERMILLION, key, letter, new_sheet
from sunarc.studies.published import FOCAL_LENGTH_P90, PRINCIPAL_POINT_P90, TRUE_RMSE
from sunarc.studies.uncertainty import Uncertainty, true_values

FloatArray = NDArray[np.float64]

RMSE_SHEET_PX = (1400, 620)
PARAMETER_SHEET_PX = (1400, 1000)

_COLOURS: dict[Method, str] = {"paper": VERMILLION, "robust": BLUE}
_NORMAL_P90 = 1.645
_NOISE = "noise of a sighting, σ (px per axis)"


def rmse_figure(study: Uncertainty) -> Figure:
    """Return the figure of the true error, on the arc (the paper's Fig. 4) and over the sky."""
    figure = new_sheet(width_px=RMSE_SHEET_PX[0], height_px=RMSE_SHEET_PX[1])
    for column, (axes, title) in enumerate(
        zip(figure.subplots(1, 2), ("on the arc (Eq. 28, Fig. 4)", "over the whole sky"), strict=True)
    ):
        for method in study.methods:
            _draw_distribution(axes, study, method, column, truth=0.0)
            bound = study.bound[method][:, column]
            axes.plot(study.sigma_px, bound, "--", color=_COLOURS[method], linewidth=1.6, label=f"{method}, bound")
        if column == 0:
            sigma, mean, half = np.array(TRUE_RMSE).T
            axes.errorbar(sigma, mean, half, fmt="s", color=INK, capsize=4.0, label="published, mean and 90 %")
            axes.set_ylim(bottom=0.0)
        else:
            axes.set_yscale("log")
        axes.set_xlim(0.0, float(study.sigma_px[-1]))
        letter(axes, x=_NOISE, y="true error of the calibration, RMSE (px)", title=title)
        key(axes, place="upper left" if column == 0 else "lower right", columns=2)
    figure.suptitle(_headline(study), fontsize=TITLE_PT)
    return figure


def parameter_figure(study: Uncertainty) -> Figure:
    """Return the figure of four parameters (the paper's Fig. 5)."""
    figure = new_sheet(width_px=PARAMETER_SHEET_PX[0], height_px=PARAMETER_SHEET_PX[1])
    names = ("αx", "αy", "x0", "y0")
    for number, axes in enumerate(figure.subplots(2, 2).flat):
        column, truth = number + 2, float(true_values()[number + 2])
        for method in study.methods:
            _draw_distribution(axes, study, method, column, truth=truth)
            half = _NORMAL_P90 * study.bound[method][:, column]
            axes.plot(study.sigma_px, half, "--", color=_COLOURS[method], linewidth=1.4, label=f"{method}, 90 % bound")
            axes.plot(study.sigma_px, -half, "--", color=_COLOURS[method], linewidth=1.4)
        per_px = FOCAL_LENGTH_P90 if number < 2 else PRINCIPAL_POINT_P90
        axes.plot(study.sigma_px, per_px * study.sigma_px, ":", color=INK, label="published, 90 %")
        axes.plot(study.sigma_px, -per_px * study.sigma_px, ":", color=INK)
        half_width = _half_width(study, column, truth)
        axes.set_ylim(-half_width, half_width)
        axes.set_xlim(0.0, float(study.sigma_px[-1]))
        letter(axes, x=_NOISE, y=f"{names[number]} − truth (px)", title=f"{names[number]} (true: {truth:.2f} px)")
    key(figure.axes[0], place="upper left", columns=2)
    figure.suptitle(_headline(study), fontsize=TITLE_PT)
    return figure


def _headline(study: Uncertainty) -> str:
    count = study.trials[study.methods[0]].shape[1]
    return f"one arc of 13 May 2013, {count} fits a level, seed {study.seed}; bands: 50 % and 90 % of the fits"


def _draw_distribution(axes: Axes, study: Uncertainty, method: Method, column: int, *, truth: float) -> None:
    drawn, colour = study.trials[method][..., column] - truth, _COLOURS[method]
    for low, high, strength in ((0.05, 0.95, 0.15), (0.25, 0.75, 0.25)):
        edges = np.quantile(drawn, [low, high], axis=1)
        axes.fill_between(study.sigma_px, *edges, color=colour, alpha=strength, linewidth=0.0)
    axes.plot(study.sigma_px, drawn.mean(axis=1), color=colour, linewidth=1.8, label=f"{method}, mean")
    axes.plot(study.sigma_px, np.median(drawn, axis=1), color=colour, linewidth=0.9, label=f"{method}, median")


def _half_width(study: Uncertainty, column: int, truth: float) -> float:
    """Return half the height of a panel: what holds the middle half of the fits of every method, with room."""
    edges = [np.quantile(study.trials[m][..., column] - truth, [0.25, 0.75], axis=1) for m in study.methods]
    return 2.5 * max(float(np.max(np.abs(edges))), 1e-6)
