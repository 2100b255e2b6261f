"""Curves of the shadow study: the height by a pair, the shadow, and the ramp of the irradiance."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sunarc.studies.drawing import BLUE, GREEN, GREY, ORANGE, TITLE_PT, VERMILLION, key, letter, new_sheet
from sunarc.studies.shadow import RAMP_W_M2, WIND_M_S, WINDOW_S, ShadowRow

SHEET_PX = (1700, 620)
_COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, GREY)
_BASELINE_M = 1000.0
_HEIGHT_M = 1000.0
_SIGMA = "direction, 1-sigma per axis (degrees)"


def shadow_figure(rows: Sequence[ShadowRow]) -> Figure:
    """Return the figure: panels of the height's, the shadow's and the irradiance's error over the direction's."""
    figure = new_sheet(width_px=SHEET_PX[0], height_px=SHEET_PX[1])
    height, shadow, ramp = figure.subplots(1, 3)
    of_height = [row for row in rows if row.height_m == _HEIGHT_M]
    for colour, baseline in zip(_COLOURS, sorted({row.baseline_m for row in of_height}), strict=False):
        chosen = [row for row in of_height if row.baseline_m == baseline]
        _draw(height, chosen, "height_sigma_m", colour, f"baseline {baseline:g} m")
    of_baseline = [row for row in rows if row.baseline_m == _BASELINE_M]
    for colour, level in zip(_COLOURS, sorted({row.height_m for row in of_baseline}), strict=False):
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
