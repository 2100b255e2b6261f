"""Figures of studies and of a calibration; matplotlib is imported with this module."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm, Normalize
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.projections.polar import PolarAxes
from numpy.typing import NDArray

from sunarc.calibration.answers.covariance import sigma_deg
from sunarc.calibration.model.options import Method
from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.utc import DAY_S
from sunarc.lab.studies.published import FOCAL_LENGTH_P90, PRINCIPAL_POINT_P90, TRUE_RMSE
from sunarc.lab.studies.residuals import Residuals
from sunarc.lab.studies.shadow import RAMP_W_M2, WIND_M_S, WINDOW_S, ShadowRow
from sunarc.lab.studies.uncertainty import UncertaintyStudy, true_values
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.directions import angles_from_direction, direction_from_angles

BLUE, VERMILLION, GREEN, ORANGE, GREY, INK = "#0072B2", "#D55E00", "#009E73", "#E69F00", "#8A8A8A", "#222222"
"""Okabe and Ito's colours, which people with any colour vision tell apart."""

LETTERING_PT = 10.0
TITLE_PT = 12.0

Location = Literal["best", "upper left", "upper right", "lower left", "lower right"]

_DPI = 100


def new_sheet(*, width_px: int, height_px: int) -> Figure:
    """Return an empty figure of a size in px, with room made for all labels when it is drawn."""
    figure = Figure(figsize=(width_px / _DPI, height_px / _DPI), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def letter(axes: Axes, *, x: str, y: str, title: str = "") -> None:
    """Name the axes, with units, and give them a light grid."""
    axes.set_xlabel(x, fontsize=LETTERING_PT)
    axes.set_ylabel(y, fontsize=LETTERING_PT)
    axes.tick_params(labelsize=LETTERING_PT - 1.0)
    axes.grid(visible=True, color="#DDDDDD", linewidth=0.6)
    axes.set_axisbelow(True)
    if title:
        axes.set_title(title, fontsize=TITLE_PT, loc="left")


def key(axes: Axes, *, location: Location = "best", columns: int = 1) -> None:
    """Draw the key of what was drawn with a label, if anything was."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc=location, ncols=columns, fontsize=LETTERING_PT - 1.0, framealpha=0.9, markerscale=1.6)


def save_png(figure: Figure, path: Path) -> Path:
    """Write a sheet as PNG and return where."""
    figure.savefig(path, format="png", dpi=_DPI, metadata={"Software": "sunarc"})
    return path


RESIDUAL_SHEET_PX = (1800, 1000)

_MOST_ARROWS = 200
_ARROW = 0.035
"""Length of the key's arrow, as a share of the image's width."""
_LONGEST_ARROW = 3.0
_HEADROOM = 1.4
_NICE = (1.0, 2.0, 5.0)


def residual_figure(calibration: Calibration, residuals: Residuals) -> Figure:
    """Return the figure of the residuals of a calibration's sightings."""
    figure = new_sheet(width_px=RESIDUAL_SHEET_PX[0], height_px=RESIDUAL_SHEET_PX[1])
    panels = figure.subplot_mosaic([["px_t", "px_z", "map"], ["deg_t", "deg_z", "map"]], width_ratios=[1.0, 1.0, 1.6])
    seen = residuals.sightings
    for name, across, label in (
        ("t", seen.unix_s / DAY_S, "time (UTC)"),  # matplotlib counts time in days from 1970
        ("z", angles_from_direction(seen.directions)[0], "apparent zenith of the sun (°)"),
    ):
        draw_components(panels[f"px_{name}"], across, residuals)
        letter(panels[f"px_{name}"], x=label, y="seen − predicted (px)")
        draw_angles(panels[f"deg_{name}"], across, residuals)
        letter(panels[f"deg_{name}"], x=label, y="angle between seen and true sun (°)")
    for panel in (panels["px_t"], panels["deg_t"]):
        _count_in_time(panel)
        key(panel, location="upper left", columns=2)
    draw_arrows(panels["map"], calibration.camera, residuals)
    figure.suptitle(headline(calibration), fontsize=TITLE_PT)
    return figure


def headline(calibration: Calibration) -> str:
    """Return the title of the figure."""
    metrics, evidence = calibration.metrics, calibration.evidence
    verdict = "accepted" if calibration.verdict.accepted else "refused"
    counts = f"{evidence.n_used} of {evidence.n_supplied} sightings used"
    scatter = f"RMSE {metrics.rmse_px:.3f} px = {metrics.rmse_deg:.4f}°" if metrics.n else "no fit"
    return f"{counts}, {scatter} ({calibration.method} method, {verdict})"


def _count_in_time(axes: Axes) -> None:
    locator = AutoDateLocator(maxticks=7)  # type: ignore[no-untyped-call] # matplotlib's stubs leave dates out
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call] # same


def draw_components(axes: Axes, across: FloatArray, residuals: Residuals) -> None:
    """Draw the residuals' components by time."""
    limit = panel_limit(np.abs(residuals.offset_px).max(axis=-1, initial=0.0), residuals.used)
    used, rejected = residuals.used, ~residuals.used
    for component, name, colour in ((0, "x", BLUE), (1, "y", ORANGE)):
        axes.plot(across[used], residuals.offset_px[used, component], ".", ms=3, color=colour, label=f"{name}, used")
    for component, mark in ((0, "x"), (1, "+")):
        label = f"{'xy'[component]}, rejected"
        draw_rejected(axes, across[rejected], residuals.offset_px[rejected, component], limit, mark=mark, label=label)
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set_ylim(-limit, limit)


def draw_angles(axes: Axes, across: FloatArray, residuals: Residuals) -> None:
    """Draw residuals by zenith angle."""
    limit = panel_limit(residuals.offset_deg, residuals.used)
    used, rejected = residuals.used, ~residuals.used
    axes.plot(across[used], residuals.offset_deg[used], ".", ms=3, color=BLUE, label="used")
    draw_rejected(axes, across[rejected], residuals.offset_deg[rejected], limit, mark="x", label="rejected")
    axes.set_ylim(0.0, limit)


def panel_limit(size: FloatArray, used: BoolArray) -> float:
    """Return how far the panel reaches: the used sightings decide, where there are any."""
    shown = size[used] if np.any(used) else size
    largest = float(np.nanmax(shown, initial=0.0))
    return _HEADROOM * largest if largest > 0.0 else 1.0


def draw_rejected(axes: Axes, across: FloatArray, off: FloatArray, limit: float, *, mark: str, label: str) -> None:
    """Draw rejected sightings; those beyond the panel stand on its edge."""
    if off.size:
        clipped = np.clip(off, -0.97 * limit, 0.97 * limit)
        beyond = int(np.sum(clipped != off))
        label_text = f"{label} ({beyond} beyond the edge)" if beyond else label
        axes.plot(across, clipped, mark, ms=5, color=VERMILLION, label=label_text, zorder=3)


def draw_arrows(axes: Axes, camera: Camera, residuals: Residuals) -> None:
    """Draw residuals over the image as arrows."""
    square = np.sum(residuals.offset_px[residuals.used] ** 2, axis=-1)
    unit = nice_number(float(np.sqrt(np.mean(square)))) if square.size else 1.0
    per_px = _ARROW * camera.width / unit
    _outline(axes, camera)
    for belongs, name, colour, key_x in (
        (~residuals.used, "rejected", VERMILLION, 0.5),
        (residuals.used, "used", BLUE, 0.04),
    ):
        rows = some_rows(belongs)
        shift = np.array(residuals.offset_px[rows])
        shift *= np.minimum(1.0, _LONGEST_ARROW * unit / np.maximum(np.linalg.norm(shift, axis=-1), 1e-12))[:, None]
        arrows = axes.quiver(
            *residuals.sightings.pixels[rows].T, *shift.T, color=colour, angles="xy", scale_units="xy",
            scale=1.0 / per_px, width=0.002, zorder=3,
        )  # fmt: skip
        if rows.size:
            label = f"{unit:g} px, {name} ({rows.size} of {int(belongs.sum())} drawn)"
            axes.quiverkey(arrows, key_x, 1.025, unit, label, labelpos="E", fontproperties={"size": LETTERING_PT})
    axes.set_xlim(-0.5, camera.width - 0.5)
    axes.set_ylim(camera.height - 0.5, -0.5)
    axes.set_aspect("equal")
    letter(axes, x="x (px)", y="y (px)")
    title = f"seen − predicted over the image, {per_px:,.0f} × as long, cut at {_LONGEST_ARROW * unit:g} px"
    axes.set_title(title, fontsize=TITLE_PT, loc="left", pad=34.0)


def _outline(axes: Axes, camera: Camera) -> None:
    """Draw the horizon, where north is on it, and the zenith."""
    azimuth = np.linspace(0.0, 360.0, 361)
    horizon = project(camera, direction_from_angles(zenith_deg=90.0, azimuth_deg=azimuth))
    axes.plot(*horizon.T, color=GREY, linewidth=1.2)
    zenith = project(camera, np.array([0.0, 0.0, 1.0]))
    axes.plot(*zenith, "+", color=INK, ms=9)
    for name, at in zip("NESW", horizon[:360:90], strict=True):
        if np.all(np.isfinite(at)):
            x, y = at + 0.045 * (zenith - at)
            axes.text(x, y, name, color=INK, fontsize=TITLE_PT, ha="center", va="center", clip_on=True, zorder=5)


def some_rows(which: BoolArray) -> NDArray[np.intp]:
    """Return at most so many rows as arrows are drawn."""
    rows = np.flatnonzero(which)
    return rows[:: max(1, -(-rows.size // _MOST_ARROWS))]


def nice_number(value: float) -> float:
    """Return the nearest of 1, 2, 5 times a power of ten, 1 for 0."""
    if value <= 0.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * min((*_NICE, 10.0), key=lambda n: abs(np.log(n * power / value))))


SKY_SHEET_PX = (1150, 1050)

_STEP_DEG = 1.5
_STEPS = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
_MOST_CONTOURS = 9


def sky_figure(calibration: Calibration, residuals: Residuals) -> Figure:
    """Return the map of 1-sigma over the sky, zenith in the middle, north up, east to the right."""
    zenith = np.arange(0.0, 90.0 + 0.5 * _STEP_DEG, _STEP_DEG)
    azimuth = np.arange(0.0, 360.0 + 0.5 * _STEP_DEG, _STEP_DEG)
    sigma = sky_sigma(calibration, zenith_deg=zenith, azimuth_deg=azimuth)
    figure = new_sheet(width_px=SKY_SHEET_PX[0], height_px=SKY_SHEET_PX[1])
    axes = figure.add_subplot(projection="polar")
    if not isinstance(axes, PolarAxes):  # for the type checker: matplotlib's stubs say Axes
        raise TypeError
    _compass(axes)
    if np.any(np.isfinite(sigma)):
        _draw_sigma(figure, axes, np.radians(azimuth), zenith, sigma)
    seen = residuals.sightings.select(residuals.used)
    sun_zenith, sun_azimuth = angles_from_direction(seen.directions[np.argsort(seen.unix_s)])
    axes.plot(
        np.radians(sun_azimuth), sun_zenith, ".", ms=2.5, color=VERMILLION, label="the sun, where it was used",
    )  # fmt: skip
    axes.legend(loc="lower left", bbox_to_anchor=(-0.06, -0.06), fontsize=LETTERING_PT, markerscale=3.0)
    extent = f"{calibration.sky_rms_deg:.4f}° RMS, {calibration.sky_max_deg:.4f}° at most"
    figure.suptitle(f"1-sigma per axis of a pixel's direction: {extent}", fontsize=TITLE_PT)
    return figure


def sky_sigma(calibration: Calibration, *, zenith_deg: FloatArray, azimuth_deg: FloatArray) -> FloatArray:
    """Return (z, a): 1-sigma per axis in degrees; NaN where the camera does not look."""
    grid_z, grid_a = np.meshgrid(zenith_deg, azimuth_deg, indexing="ij")
    directions = direction_from_angles(zenith_deg=grid_z, azimuth_deg=grid_a).reshape(-1, 3)
    sigma = sigma_deg(calibration, directions)
    return np.where(within_image(calibration.camera, directions), sigma, np.nan).reshape(grid_z.shape)


def within_image(camera: Camera, directions: FloatArray) -> BoolArray:
    """Return which directions land within the image."""
    pixels = project(camera, directions)
    with np.errstate(invalid="ignore"):
        inside = (pixels >= -0.5) & (pixels <= np.array([camera.width, camera.height]) - 0.5)
    return np.asarray(np.all(inside, axis=-1))


def _compass(axes: PolarAxes) -> None:
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    names = {0: "N 0°", 90: "E 90°", 180: "S 180°", 270: "W 270°"}
    azimuths = list(range(0, 360, 30))
    axes.set_thetagrids(azimuths, [names.get(a, f"{a}°") for a in azimuths], fontsize=LETTERING_PT + 1.0)
    axes.tick_params(axis="x", pad=8.0)
    axes.set_rlim(0.0, 90.0)
    axes.set_rgrids([30, 60, 90], ["30°", "60°", "90°"], angle=15.0, fontsize=LETTERING_PT - 1.0, color=INK)
    axes.grid(visible=True, color="#FFFFFF", linewidth=0.6, alpha=0.5)


def _draw_sigma(figure: Figure, axes: PolarAxes, azimuth: FloatArray, zenith: FloatArray, sigma: FloatArray) -> None:
    low, high = float(np.nanmin(sigma)), float(np.nanmax(sigma))
    scale = LogNorm(low, high) if low > 0.0 and high > 3.0 * low else Normalize(0.0, high)
    shown = np.ma.masked_invalid(sigma)
    colours = axes.pcolormesh(azimuth, zenith, shown, cmap="cividis", norm=scale, shading="gouraud", zorder=0)
    bar = figure.colorbar(colours, ax=axes, shrink=0.75, pad=0.08, format="%.3g")
    bar.set_label("1-sigma per axis (°)", fontsize=LETTERING_PT + 1.0)
    bar.ax.tick_params(labelsize=LETTERING_PT, which="both")
    levels = contour_levels(low, high)
    bar.set_ticks(levels or [high])
    bar.ax.minorticks_off()
    if levels:
        lines = axes.contour(azimuth, zenith, shown, levels=levels, colors="#FFFFFF", linewidths=1.0)
        rim: list[AbstractPathEffect] = [withStroke(linewidth=2.0, foreground=INK)]
        lines.set_path_effects(rim)
        for label in axes.clabel(lines, fmt="%.3g°", fontsize=LETTERING_PT):
            label.set_path_effects(rim)


def contour_levels(low: float, high: float) -> list[float]:
    """Return round numbers strictly between two bounds, few enough to be read, and none where the bounds are alike."""
    if not 0.0 < low < high:
        return []
    powers = range(int(np.floor(np.log10(low))), int(np.floor(np.log10(high))) + 1)
    levels = [round(step * 10.0**power, 12) for power in powers for step in _STEPS]
    between = [level for level in levels if low < level < high]
    return between[:: max(1, math.ceil(len(between) / _MOST_CONTOURS))]


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
        _draw(height, chosen, "height_sigma_m", colour, f"baseline {baseline:g} m")
    of_baseline = [row for row in rows if row.baseline_m == _BASELINE_M]
    for colour, level in zip(_SHADOW_COLOURS, sorted({row.height_m for row in of_baseline}), strict=False):
        chosen = [row for row in of_baseline if row.height_m == level]
        _draw(shadow, chosen, "shadow_pair_sigma_m", colour, f"base {level:g} m, by the pair")
        _draw(shadow, chosen, "shadow_sigma_m", colour, "the same, height known", style="--")
        _draw(ramp, chosen, "ramp_error_w_m2", colour, f"base {level:g} m")
    letter(height, x=_SIGMA, y="cloud base height, 1-sigma (m)", title=f"height by a pair, base {_HEIGHT_M:g} m")
    letter(shadow, x=_SIGMA, y="shadow, 1-sigma per axis (m)", title=f"shadow, baseline {_BASELINE_M:g} m")
    letter(
        ramp, x=_SIGMA, y="irradiance, mean absolute error (W/m²)", title=f"a ramp within {WINDOW_S / 60.0:g} minutes"
    )
    for axes in (height, shadow, ramp):
        key(axes, location="upper left")
    figure.suptitle(f"cloud to 60° zenith angle, wind {WIND_M_S:g} m/s, ramp of {RAMP_W_M2:g} W/m²", fontsize=TITLE_PT)
    return figure


def _draw(axes: Axes, rows: Sequence[ShadowRow], name: str, colour: str, label: str, *, style: str = "-") -> None:
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
    figure.suptitle(_study_headline(study), fontsize=TITLE_PT)
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
    figure.suptitle(_study_headline(study), fontsize=TITLE_PT)
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


def _study_headline(study: UncertaintyStudy) -> str:
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
