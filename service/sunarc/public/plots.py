"""Figures of a calibration: residuals, and uncertainty over the image and the sky; matplotlib comes with them."""

from __future__ import annotations

import math
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
from sunarc.calibration.answers.direction_table import Lookup
from sunarc.calibration.answers.residuals import Residuals, compute_residuals
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.utc import DAY_S
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.directions import angles_from_direction, direction_from_angles
from sunarc.sources.files import writing_into

BLUE, VERMILLION, GREEN, ORANGE, GREY, INK = "#0072B2", "#D55E00", "#009E73", "#E69F00", "#8A8A8A", "#222222"
"""Okabe and Ito's colours, which people with any colour vision tell apart."""

LETTERING_PT = 10.0
TITLE_PT = 12.0

Location = Literal["best", "upper left", "upper right", "lower left", "lower right"]

_DPI = 100


def new_sheet(*, width_px: int, height_px: int) -> Figure:
    """Return an empty figure of a size in px, with a layout that leaves room for all labels."""
    figure = Figure(figsize=(width_px / _DPI, height_px / _DPI), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def letter(axes: Axes, *, x: str, y: str, title: str = "") -> None:
    """Label the axes, with units, and give them a light grid."""
    axes.set_xlabel(x, fontsize=LETTERING_PT)
    axes.set_ylabel(y, fontsize=LETTERING_PT)
    axes.tick_params(labelsize=LETTERING_PT - 1.0)
    axes.grid(visible=True, color="#DDDDDD", linewidth=0.6)
    axes.set_axisbelow(True)
    if title:
        axes.set_title(title, fontsize=TITLE_PT, loc="left")


def key(axes: Axes, *, location: Location = "best", columns: int = 1) -> None:
    """Draw the legend of the labelled parts, if there are any."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc=location, ncols=columns, fontsize=LETTERING_PT - 1.0, framealpha=0.9, markerscale=1.6)


def save_png(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG, and return its path."""
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
        _set_time_axis(panel)
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


def _set_time_axis(axes: Axes) -> None:
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
    """Return the limit of a panel's axis: by the used sightings, where there are any."""
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


def draw_arrows(axes: Axes, camera: Camera, residuals: Residuals) -> Axes:
    """Draw residuals over the image as arrows, x right and y down as in the picture, and return the axes."""
    square = np.sum(residuals.offset_px[residuals.used] ** 2, axis=-1)
    unit = nice_number(float(np.sqrt(np.mean(square)))) if square.size else 1.0
    per_px = _ARROW * camera.width / unit
    _draw_outline(axes, camera)
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
    _orient_as_picture(axes, camera)
    letter(axes, x="x (px)", y="y (px)")
    title = f"seen − predicted over the image, {per_px:,.0f} × as long, cut at {_LONGEST_ARROW * unit:g} px"
    axes.set_title(title, fontsize=TITLE_PT, loc="left", pad=34.0)
    return axes


def _draw_outline(axes: Axes, camera: Camera) -> None:
    """Draw the horizon, where north is on it, and the zenith."""
    azimuth = np.linspace(0.0, 360.0, 361)
    horizon = project(camera, direction_from_angles(zenith_deg=90.0, azimuth_deg=azimuth))
    axes.plot(*horizon.T, color=GREY, linewidth=1.2)
    zenith = project(camera, np.array([0.0, 0.0, 1.0]))
    axes.plot(*zenith, "+", color=INK, ms=9)
    for name, at in zip("NESW", horizon[:360:90], strict=True):
        if np.all(np.isfinite(at)):
            x, y = at + 0.045 * (zenith - at)
            letter_ = axes.text(x, y, name, color=INK, fontsize=TITLE_PT, ha="center", va="center", clip_on=True)
            # a number of a contour below it is covered whole
            letter_.set(zorder=5, bbox={"boxstyle": "circle,pad=0.25", "facecolor": "#FFFFFF", "edgecolor": GREY})


def some_rows(which: BoolArray) -> NDArray[np.intp]:
    """Return the rows that are drawn as arrows: at most a fixed number."""
    rows = np.flatnonzero(which)
    return rows[:: max(1, -(-rows.size // _MOST_ARROWS))]


def nice_number(value: float) -> float:
    """Return the nearest of 1, 2, 5 times a power of ten, 1 for 0."""
    if value <= 0.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * min((*_NICE, 10.0), key=lambda n: abs(np.log(n * power / value))))


SKY_SHEET_PX = (1150, 1050)
_HORIZON_DEG = 90.0
_NOTEBOOK_INCHES = (8.0, 7.0)
_CELLS = 240
"""Cells along the image's shorter side whose 1-sigma is drawn."""

_STEP_DEG = 1.5
_STEPS = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
_MOST_CONTOURS = 9


def axes_or_new(axes: Axes | None, *, projection: str | None = None) -> Axes:
    """Return the given axes, or those of a new figure that a notebook shows."""
    if axes is not None:
        return axes
    from matplotlib import pyplot as plt  # noqa: PLC0415 - it chooses a window system; sheets need none

    return plt.figure(figsize=_NOTEBOOK_INCHES, layout="constrained").add_subplot(projection=projection)


def draw_uncertainty(axes: Axes, calibration: Calibration, ready: Lookup) -> Axes:
    """Draw the 1-sigma of pixels over the image, x right and y down as in the picture, and return the axes."""
    camera = calibration.camera
    step = max(1, min(camera.width, camera.height) // _CELLS)
    x, y = (np.arange(0.0, size, step) for size in (camera.width, camera.height))
    found = ready.back_project(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    of_the_sky = (found[:, 6] == 1.0) & (found[:, 0] <= _HORIZON_DEG)
    sigma = np.where(of_the_sky, found[:, 5], np.nan).reshape(len(y), len(x))
    if np.any(np.isfinite(sigma)):
        _draw_sigma(axes, x, y, sigma)
    _draw_outline(axes, camera)
    _orient_as_picture(axes, camera)
    letter(axes, x="x (px)", y="y (px)", title="1-sigma per axis of a pixel's direction")
    axes.grid(visible=False)
    return axes


def _orient_as_picture(axes: Axes, camera: Camera) -> None:
    """Orient axes as the picture is: x right, y down, over all of it."""
    axes.set_xlim(-0.5, camera.width - 0.5)
    axes.set_ylim(camera.height - 0.5, -0.5)
    axes.set_aspect("equal")


def sky_figure(calibration: Calibration, residuals: Residuals) -> Figure:
    """Return the map of 1-sigma over the sky, zenith in the middle, north and east on the sides of the picture."""
    figure = new_sheet(width_px=SKY_SHEET_PX[0], height_px=SKY_SHEET_PX[1])
    draw_sky(figure.add_subplot(projection="polar"), calibration, residuals)
    return figure


def draw_sky(axes: Axes, calibration: Calibration, residuals: Residuals | None) -> Axes:
    """Draw the 1-sigma over the sky, turned as the picture is, and the suns that were used; return the axes."""
    zenith = np.arange(0.0, 90.0 + 0.5 * _STEP_DEG, _STEP_DEG)
    azimuth = np.arange(0.0, 360.0 + 0.5 * _STEP_DEG, _STEP_DEG)
    sigma = sky_sigma(calibration, zenith_deg=zenith, azimuth_deg=azimuth)
    if not isinstance(axes, PolarAxes):  # for the type checker: matplotlib's stubs say Axes
        raise TypeError
    _label_compass(axes, calibration.camera)
    if np.any(np.isfinite(sigma)):
        _draw_sigma(axes, np.radians(azimuth), zenith, sigma)
    if residuals is not None:
        seen = residuals.sightings.select(residuals.used)
        sun_zenith, sun_azimuth = angles_from_direction(seen.directions[np.argsort(seen.unix_s)])
        label = "the sun, where it was used"
        axes.plot(np.radians(sun_azimuth), sun_zenith, ".", ms=2.5, color=VERMILLION, label=label)
        axes.legend(loc="lower left", bbox_to_anchor=(-0.15, -0.15), fontsize=LETTERING_PT, markerscale=3.0)
    extent = f"{calibration.sky_rms_deg:.4f}° RMS, {calibration.sky_max_deg:.4f}° at most"
    axes.set_title(f"1-sigma per axis of a pixel's direction\n{extent}", fontsize=TITLE_PT, pad=18.0)
    return axes


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


_NEAR_ZENITH_DEG = 5.0


def _label_compass(axes: PolarAxes, camera: Camera) -> None:
    """Name azimuth and zenith angle; north lies where it does in the picture, and east on the same side of it."""
    zenith, north, east = project(
        camera,
        direction_from_angles(zenith_deg=[0.0, _NEAR_ZENITH_DEG, _NEAR_ZENITH_DEG], azimuth_deg=[0.0, 0.0, 90.0]),
    )
    (north_x, north_y), (east_x, east_y) = north - zenith, east - zenith
    if np.isfinite(north_x * east_x):
        axes.set_theta_offset(math.atan2(-north_y, north_x))  # y is down in the picture
        axes.set_theta_direction(-1 if north_x * east_y - north_y * east_x > 0.0 else 1)
    else:  # the zenith is not in the picture
        axes.set_theta_zero_location("N")
        axes.set_theta_direction(-1 if camera.mirrored else 1)
    names = {0: "N 0°", 90: "E 90°", 180: "S 180°", 270: "W 270°"}
    azimuths = list(range(0, 360, 30))
    axes.set_thetagrids(azimuths, [names.get(a, f"{a}°") for a in azimuths], fontsize=LETTERING_PT + 1.0)
    axes.tick_params(axis="x", pad=8.0)
    axes.set_rlim(0.0, 90.0)
    rings = axes.set_rgrids([30, 60], ["30°", "60°"], angle=15.0, fontsize=LETTERING_PT - 1.0, color="#FFFFFF")[1]
    for ring in rings:
        ring.set_path_effects([withStroke(linewidth=2.0, foreground=INK)])
    axes.grid(visible=True, color="#FFFFFF", linewidth=0.6, alpha=0.5)


def _draw_sigma(axes: Axes, across: FloatArray, up: FloatArray, sigma: FloatArray) -> None:
    """Draw colours and contours of 1-sigma (rows, columns) over the axes' coordinates of columns and rows."""
    low, high = float(np.nanmin(sigma)), float(np.nanmax(sigma))
    scale = LogNorm(low, high) if low > 0.0 and high > 3.0 * low else Normalize(0.0, high)
    shown = np.ma.masked_invalid(sigma)
    colours = axes.pcolormesh(across, up, shown, cmap="cividis", norm=scale, shading="gouraud", zorder=0)
    bar = axes.figure.colorbar(colours, ax=axes, shrink=0.75, pad=0.08, format="%.3g")
    bar.set_label("1-sigma per axis (°)", fontsize=LETTERING_PT + 1.0)
    bar.ax.tick_params(labelsize=LETTERING_PT, which="both")
    levels = contour_levels(low, high)
    bar.set_ticks(levels or [high])
    bar.ax.minorticks_off()
    if levels:
        lines = axes.contour(across, up, shown, levels=levels, colors="#FFFFFF", linewidths=1.0)
        rim: list[AbstractPathEffect] = [withStroke(linewidth=2.0, foreground=INK)]
        lines.set_path_effects(rim)
        for label in axes.clabel(lines, fmt="%.3g°", fontsize=LETTERING_PT):
            label.set_path_effects(rim)


def contour_levels(low: float, high: float) -> list[float]:
    """Return round numbers strictly between two bounds, few enough to be read; empty where the bounds are alike."""
    if not 0.0 < low < high:
        return []
    powers = range(int(np.floor(np.log10(low))), int(np.floor(np.log10(high))) + 1)
    levels = [round(step * 10.0**power, 12) for power in powers for step in _STEPS]
    between = [level for level in levels if low < level < high]
    return between[:: max(1, math.ceil(len(between) / _MOST_CONTOURS))]


def write_calibration_plots(calibration: Calibration, points: Sightings, *, folder: Path) -> tuple[Path, ...]:
    """Write the residuals of a calibration and its uncertainty over the sky as PNG.

    Parameters
    ----------
    calibration : accepted or refused.
    points : the sightings that it was made from.
    folder : where to; made where it is missing.

    Returns
    -------
    The files: `residuals.png` and `sky.png`.

    Raises
    ------
    InputError
        Where they cannot be written.
    """
    residuals = compute_residuals(calibration, points)
    with writing_into(folder):
        return (
            save_png(residual_figure(calibration, residuals), folder / "residuals.png"),
            save_png(sky_figure(calibration, residuals), folder / "sky.png"),
        )
