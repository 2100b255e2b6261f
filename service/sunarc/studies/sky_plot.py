"""The map of how sure a calibration is of every direction of the sky."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.projections.polar import PolarAxes

from sunarc.array_types import BoolArray, FloatArray
from sunarc.calibration.model.covariance import sigma_deg
from sunarc.calibration.model.result import Calibration
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.directions import direction_from_angles
from sunarc.studies.drawing import INK, LETTERING_PT, TITLE_PT, VERMILLION, new_sheet
from sunarc.studies.residuals import Residuals

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
    order = np.argsort(residuals.unix_s[residuals.used])
    axes.plot(
        np.radians(residuals.azimuth_deg[residuals.used][order]),
        residuals.apparent_zenith_deg[residuals.used][order],
        ".", ms=2.5, color=VERMILLION, label="the sun, where it was used",
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
    return np.where(_within(calibration.camera, directions), sigma, np.nan).reshape(grid_z.shape)


def _within(camera: Camera, directions: FloatArray) -> BoolArray:
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
