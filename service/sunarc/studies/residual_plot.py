"""The figure of the residuals: against time, against the sun's zenith angle, and over the image."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sunarc.array_types import BoolArray, FloatArray
from sunarc.calibration.model.result import Calibration
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.directions import direction_from_angles
from sunarc.studies.drawing import BLUE, GREY, INK, LETTERING_PT, ORANGE, TITLE_PT, VERMILLION, key, letter, new_sheet
from sunarc.studies.residuals import Residuals
from sunarc.utc import DAY_S

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
    for name, across, label in (
        ("t", residuals.unix_s / DAY_S, "time (UTC)"),  # matplotlib counts time in days from 1970
        ("z", residuals.apparent_zenith_deg, "apparent zenith of the sun (°)"),
    ):
        _draw_components(panels[f"px_{name}"], across, residuals)
        letter(panels[f"px_{name}"], x=label, y="seen − predicted (px)")
        _draw_angles(panels[f"deg_{name}"], across, residuals)
        letter(panels[f"deg_{name}"], x=label, y="angle between seen and true sun (°)")
    for panel in (panels["px_t"], panels["deg_t"]):
        _count_in_time(panel)
        key(panel, location="upper left", columns=2)
    _draw_arrows(panels["map"], calibration.camera, residuals)
    figure.suptitle(_headline(calibration), fontsize=TITLE_PT)
    return figure


def _headline(calibration: Calibration) -> str:
    metrics, evidence = calibration.metrics, calibration.evidence
    verdict = "accepted" if calibration.verdict.accepted else "refused"
    counts = f"{evidence.n_used} of {evidence.n_supplied} sightings used"
    scatter = f"RMSE {metrics.rmse_px:.3f} px = {metrics.rmse_deg:.4f}°" if metrics.n else "no fit"
    return f"{counts}, {scatter} ({calibration.method} method, {verdict})"


def _count_in_time(axes: Axes) -> None:
    locator = AutoDateLocator(maxticks=7)  # type: ignore[no-untyped-call] # matplotlib's stubs leave dates out
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call] # same


def _draw_components(axes: Axes, across: FloatArray, residuals: Residuals) -> None:
    limit = _limit(np.abs(residuals.offset_px).max(axis=-1, initial=0.0), residuals.used)
    used, rejected = residuals.used, ~residuals.used
    for component, name, colour in ((0, "x", BLUE), (1, "y", ORANGE)):
        axes.plot(across[used], residuals.offset_px[used, component], ".", ms=3, color=colour, label=f"{name}, used")
    for component, mark in ((0, "x"), (1, "+")):
        label = f"{'xy'[component]}, rejected"
        _draw_rejected(axes, across[rejected], residuals.offset_px[rejected, component], limit, mark=mark, label=label)
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set_ylim(-limit, limit)


def _draw_angles(axes: Axes, across: FloatArray, residuals: Residuals) -> None:
    limit = _limit(residuals.offset_deg, residuals.used)
    used, rejected = residuals.used, ~residuals.used
    axes.plot(across[used], residuals.offset_deg[used], ".", ms=3, color=BLUE, label="used")
    _draw_rejected(axes, across[rejected], residuals.offset_deg[rejected], limit, mark="x", label="rejected")
    axes.set_ylim(0.0, limit)


def _limit(size: FloatArray, used: BoolArray) -> float:
    """Return how far the panel reaches: the used sightings decide, where there are any."""
    shown = size[used] if np.any(used) else size
    largest = float(np.nanmax(shown, initial=0.0))
    return _HEADROOM * largest if largest > 0.0 else 1.0


def _draw_rejected(axes: Axes, across: FloatArray, off: FloatArray, limit: float, *, mark: str, label: str) -> None:
    """Draw rejected sightings; those beyond the panel stand on its edge."""
    if off.size:
        clipped = np.clip(off, -0.97 * limit, 0.97 * limit)
        beyond = int(np.sum(clipped != off))
        label_text = f"{label} ({beyond} beyond the edge)" if beyond else label
        axes.plot(across, clipped, mark, ms=5, color=VERMILLION, label=label_text, zorder=3)


def _draw_arrows(axes: Axes, camera: Camera, residuals: Residuals) -> None:
    square = np.sum(residuals.offset_px[residuals.used] ** 2, axis=-1)
    unit = _nice(float(np.sqrt(np.mean(square)))) if square.size else 1.0
    per_px = _ARROW * camera.width / unit
    _outline(axes, camera)
    for belongs, name, colour, key_x in (
        (~residuals.used, "rejected", VERMILLION, 0.5),
        (residuals.used, "used", BLUE, 0.04),
    ):
        rows = _some(belongs)
        shift = np.array(residuals.offset_px[rows])
        shift *= np.minimum(1.0, _LONGEST_ARROW * unit / np.maximum(np.linalg.norm(shift, axis=-1), 1e-12))[:, None]
        arrows = axes.quiver(
            *residuals.pixels[rows].T, *shift.T, color=colour, angles="xy", scale_units="xy", scale=1.0 / per_px,
            width=0.002, zorder=3,
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


def _some(which: BoolArray) -> NDArray[np.intp]:
    rows = np.flatnonzero(which)
    return rows[:: max(1, -(-rows.size // _MOST_ARROWS))]


def _nice(value: float) -> float:
    """Return the nearest of 1, 2, 5 times a power of ten, 1 for 0."""
    if value <= 0.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * min((*_NICE, 10.0), key=lambda n: abs(np.log(n * power / value))))
