"""Figures of the studies; matplotlib is imported with this module."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sunarc.calibration.model.options import Method
from sunarc.lab.studies.published import FOCAL_LENGTH_P90, PRINCIPAL_POINT_P90, TRUE_RMSE
from sunarc.lab.studies.shadow import RAMP_W_M2, WIND_M_S, WINDOW_S, ShadowRow
from sunarc.lab.studies.uncertainty import UncertaintyStudy, true_values
from sunarc.public.plots import BLUE, GREEN, GREY, INK, ORANGE, TITLE_PT, VERMILLION, key, letter, new_sheet

SHEET_PX = (1700, 620)
_SHADOW_COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, GREY)
_BASELINE_M = 1000.0
_HEIGHT_M = 1000.0
_SIGMA = "direction, 1-sigma per axis (degrees)"


def shadow_figure(rows: Sequence[ShadowRow]) -> Figure:
    """Return the figure: panels of the height's, the shadow's and the irradiance's error over the direction's."""
    figure = new_sheet(width_px=SHEET_PX[0], height_px=SHEET_PX[1])
    height, shadow, ramp = figure.subplots(1, 3)
    of_height = [row for row in rows if row.height_m == _HEIGHT_M]
    for colour, baseline in zip(_SHADOW_COLOURS, sorted({row.baseline_m for row in of_height}), strict=False):
        chosen = [row for row in of_height if row.baseline_m == baseline]
        _draw_curve(height, chosen, "height_sigma_m", colour, f"baseline {baseline:g} m")
    of_baseline = [row for row in rows if row.baseline_m == _BASELINE_M]
    for colour, level in zip(_SHADOW_COLOURS, sorted({row.height_m for row in of_baseline}), strict=False):
        chosen = [row for row in of_baseline if row.height_m == level]
        _draw_curve(shadow, chosen, "shadow_pair_sigma_m", colour, f"base {level:g} m, by the pair")
        _draw_curve(shadow, chosen, "shadow_sigma_m", colour, "the same, height known", style="--")
        _draw_curve(ramp, chosen, "ramp_error_w_m2", colour, f"base {level:g} m")
    letter(height, x=_SIGMA, y="cloud base height, 1-sigma (m)", title=f"height by a pair, base {_HEIGHT_M:g} m")
    letter(shadow, x=_SIGMA, y="shadow, 1-sigma per axis (m)", title=f"shadow, baseline {_BASELINE_M:g} m")
    letter(
        ramp, x=_SIGMA, y="irradiance, mean absolute error (W/m²)", title=f"a ramp within {WINDOW_S / 60.0:g} minutes"
    )
    for axes in (height, shadow, ramp):
        key(axes, location="upper left")
    figure.suptitle(f"cloud to 60° zenith angle, wind {WIND_M_S:g} m/s, ramp of {RAMP_W_M2:g} W/m²", fontsize=TITLE_PT)
    return figure


def _draw_curve(axes: Axes, rows: Sequence[ShadowRow], name: str, colour: str, label: str, *, style: str = "-") -> None:
    ordered = sorted(rows, key=lambda row: row.sigma_deg)
    values = [getattr(row, name) for row in ordered]
    axes.loglog([row.sigma_deg for row in ordered], values, style, marker=".", color=colour, label=label, linewidth=1.6)


RMSE_SHEET_PX = (1400, 620)
PARAMETER_SHEET_PX = (1800, 950)

_COLOURS: dict[Method, str] = {"paper": VERMILLION, "robust": BLUE}
_NORMAL_P90 = 1.645
_NOISE = "noise of a sighting, σ (px per axis)"


def rmse_figure(study: UncertaintyStudy) -> Figure:
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
    figure.suptitle(_format_headline(study), fontsize=TITLE_PT)
    return figure


def parameter_figure(study: UncertaintyStudy) -> Figure:
    """Return the figure of four parameters (the paper's Fig. 5), a row for each method, each panel to its own scale."""
    figure = new_sheet(width_px=PARAMETER_SHEET_PX[0], height_px=PARAMETER_SHEET_PX[1])
    names = ("αx", "αy", "x0", "y0")
    panels = figure.subplots(len(study.methods), len(names), squeeze=False)
    for method, row in zip(study.methods, panels, strict=True):
        for number, axes in enumerate(row):
            _draw_parameter(axes, study, method, number + 2)
            letter(axes, x=_NOISE, y=f"{names[number]} − truth (px)", title=f"{names[number]}, {method} method")
        key(row[0], location="lower left")
    figure.suptitle(_format_headline(study), fontsize=TITLE_PT)
    return figure


def _draw_parameter(axes: Axes, study: UncertaintyStudy, method: Method, column: int) -> None:
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


def _format_headline(study: UncertaintyStudy) -> str:
    count = study.trials[study.methods[0]].shape[1]
    return f"one arc of 13 May 2013, {count} fits a level, seed {study.seed}; bands: 50 % and 90 % of the fits"


def _draw_distribution(axes: Axes, study: UncertaintyStudy, method: Method, column: int, *, truth: float) -> None:
    """Draw mean, median and bands, from the first level with noise on: without any, nothing is distributed."""
    drawn, sigma, colour = study.trials[method][1:, :, column] - truth, study.sigma_px[1:], _COLOURS[method]
    for low, high, strength in ((0.05, 0.95, 0.15), (0.25, 0.75, 0.25)):
        edges = np.quantile(drawn, [low, high], axis=1)
        axes.fill_between(sigma, *edges, color=colour, alpha=strength, linewidth=0.0)
    axes.plot(sigma, drawn.mean(axis=1), color=colour, linewidth=1.8, label=f"{method}, mean")
    axes.plot(sigma, np.median(drawn, axis=1), color=colour, linewidth=0.9, label=f"{method}, median")
