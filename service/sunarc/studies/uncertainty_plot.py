"""The paper's Figs. 4 and 5, with both methods, the whole sky, and the Cramér–Rao bound."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sunarc.calibration.model.options import Method
from sunarc.studies.drawing import BLUE, INK, TITLE_PT, VERMILLION, key, letter, new_sheet
from sunarc.studies.published import FOCAL_LENGTH_P90, PRINCIPAL_POINT_P90, TRUE_RMSE
from sunarc.studies.uncertainty import Uncertainty, true_values

RMSE_SHEET_PX = (1400, 620)
PARAMETER_SHEET_PX = (1800, 950)

_COLOURS: dict[Method, str] = {"paper": VERMILLION, "robust": BLUE}
_NORMAL_P90 = 1.645
_NOISE = "noise of a sighting, σ (px per axis)"


def rmse_figure(study: Uncertainty) -> Figure:
    """Return the figure of the true error, on the arc (the paper's Fig. 4) and over the sky."""
    figure = new_sheet(width_px=RMSE_SHEET_PX[0], height_px=RMSE_SHEET_PX[1])
    on_arc, on_sky = figure.subplots(1, 2)
    for column, axes in enumerate((on_arc, on_sky)):
        for method in study.methods:
            _draw_distribution(axes, study, method, column, truth=0.0)
            bound, colour = study.bound[method][1:, column], _COLOURS[method]
            axes.plot(study.sigma_px[1:], bound, "--", color=colour, linewidth=1.6, label=f"{method}, bound")
        axes.set_xlim(0.0, float(study.sigma_px[-1]))
    sigma, mean, half = np.array(TRUE_RMSE).T
    on_arc.errorbar(sigma, mean, half, fmt="s", ms=4, color=INK, capsize=4.0, label="published, mean and 90 %")
    on_arc.set_ylim(bottom=0.0)
    on_sky.set_yscale("log")
    label = "true error of the calibration, RMSE (px)"
    letter(on_arc, x=_NOISE, y=label, title="on the arc (Eq. 28, Fig. 4)")
    letter(on_sky, x=_NOISE, y=label, title="over the whole sky")
    key(on_arc, location="upper left", columns=2)
    figure.suptitle(_headline(study), fontsize=TITLE_PT)
    return figure


def parameter_figure(study: Uncertainty) -> Figure:
    """Return the figure of four parameters (the paper's Fig. 5), a row for each method, each panel to its own scale."""
    figure = new_sheet(width_px=PARAMETER_SHEET_PX[0], height_px=PARAMETER_SHEET_PX[1])
    names = ("αx", "αy", "x0", "y0")
    panels = figure.subplots(len(study.methods), len(names), squeeze=False)
    for method, row in zip(study.methods, panels, strict=True):
        for number, axes in enumerate(row):
            _draw_parameter(axes, study, method, number + 2)
            letter(axes, x=_NOISE, y=f"{names[number]} − truth (px)", title=f"{names[number]}, {method} method")
        key(row[0], location="lower left")
    figure.suptitle(_headline(study), fontsize=TITLE_PT)
    return figure


def _draw_parameter(axes: Axes, study: Uncertainty, method: Method, column: int) -> None:
    truth, sigma = float(true_values()[column]), study.sigma_px
    _draw_distribution(axes, study, method, column, truth=truth)
    bound = _NORMAL_P90 * study.bound[method][:, column]
    published = (FOCAL_LENGTH_P90 if column < 4 else PRINCIPAL_POINT_P90) * sigma
    for half, style, colour, label in (
        (bound, "--", _COLOURS[method], f"{method}, 90 % bound"),
        (published, ":", INK, "published, 90 %"),
    ):
        axes.plot(sigma, half, style, color=colour, linewidth=1.6, label=label)
        axes.plot(sigma, -half, style, color=colour, linewidth=1.6)
    middle = np.abs(np.quantile(study.trials[method][..., column] - truth, [0.25, 0.75], axis=1))
    half_height = 1.4 * max(float(np.max(middle)), float(np.max(bound)), float(np.max(published)))
    axes.set_ylim(-half_height, half_height)
    axes.set_xlim(0.0, float(sigma[-1]))


def _headline(study: Uncertainty) -> str:
    count = study.trials[study.methods[0]].shape[1]
    return f"one arc of 13 May 2013, {count} fits a level, seed {study.seed}; bands: 50 % and 90 % of the fits"


def _draw_distribution(axes: Axes, study: Uncertainty, method: Method, column: int, *, truth: float) -> None:
    """Draw mean, median and bands, from the first level with noise on: without any, nothing is distributed."""
    drawn, sigma, colour = study.trials[method][1:, :, column] - truth, study.sigma_px[1:], _COLOURS[method]
    for low, high, strength in ((0.05, 0.95, 0.15), (0.25, 0.75, 0.25)):
        edges = np.quantile(drawn, [low, high], axis=1)
        axes.fill_between(sigma, *edges, color=colour, alpha=strength, linewidth=0.0)
    axes.plot(sigma, drawn.mean(axis=1), color=colour, linewidth=1.8, label=f"{method}, mean")
    axes.plot(sigma, np.median(drawn, axis=1), color=colour, linewidth=0.9, label=f"{method}, median")
