"""Drawings of the report as SVG: epochs on a time line, residuals over time."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.utc import utc_time

_WIDTH, _LEFT, _RIGHT = 960, 60, 12
_COLOURS = {"start": "#4477aa", "moved": "#ee6677", "lens": "#aa3377", "clock": "#ccbb44"}
"""By the cause of an epoch: P. Tol's scheme, which people with a colour deficiency can tell apart."""
_MOST_POINTS = 4000


def time_line(epochs: Sequence[tuple[str, str, float, float]]) -> str:
    """Return epochs on a time line.

    Parameters
    ----------
    epochs : name, cause, begin and end (seconds since 1970-01-01 UTC) of each.
    """
    if not epochs:
        return ""
    at = _scale(epochs[0][2], epochs[-1][3])
    parts = []
    for name, cause, start, end in epochs:
        x, width = at(start), max(at(end) - at(start), 2.0)
        title = f"{name}, {cause}: {utc_time(start):%Y-%m-%d %H:%M} to {utc_time(end):%Y-%m-%d %H:%M}"
        parts.append(
            f'<rect x="{x:.1f}" y="6" width="{width:.1f}" height="22" fill="{_COLOURS[cause]}"><title>{escape(title)}'
            f'</title></rect><text x="{x + 3:.1f}" y="44">{escape(name)} {escape(cause)}</text>'
        )
    return _svg(60, "Epochs on a time line", "".join(parts))


def residuals(unix_s: FloatArray, distance_px: FloatArray) -> str:
    """Return how far sightings are from their calibration, (n,) px, over time."""
    if unix_s.size == 0:
        return ""
    some = np.unique(np.linspace(0, unix_s.size - 1, min(unix_s.size, _MOST_POINTS)).astype(int))
    top = max(float(np.quantile(distance_px, 0.98)) * 1.2, 0.1)
    at = _scale(float(unix_s[0]), float(unix_s[-1]))
    high = np.minimum(distance_px / top, 1.0)
    dots = "".join(
        f'<circle cx="{at(float(unix_s[n])):.1f}" cy="{150.0 - 140.0 * high[n]:.1f}" r="1.5"/>' for n in some.tolist()
    )
    axis = (
        f'<text x="2" y="16">{top:.2f} px</text><text x="2" y="154">0</text>'
        f'<text x="{_LEFT}" y="172">{utc_time(float(unix_s[0])):%Y-%m-%d}</text>'
        f'<text x="{_WIDTH - 90}" y="172">{utc_time(float(unix_s[-1])):%Y-%m-%d}</text>'
        f'<line x1="{_LEFT}" y1="150" x2="{_WIDTH - _RIGHT}" y2="150" stroke="#888"/>'
    )
    return _svg(
        180, "Distance of the sightings from their calibration over time", axis + f'<g fill="#4477aa">{dots}</g>'
    )


class _scale:  # noqa: N801 - called as a function
    """Times to horizontal places."""

    def __init__(self, start: float, end: float) -> None:
        self._start, self._span = start, max(end - start, 1.0)

    def __call__(self, unix_s: float) -> float:
        return _LEFT + (_WIDTH - _LEFT - _RIGHT) * (unix_s - self._start) / self._span


def _svg(height: int, title: str, content: str) -> str:
    return (
        f'<svg role="img" aria-label="{escape(title)}" viewBox="0 0 {_WIDTH} {height}" width="100%" font-size="11" '
        f'font-family="sans-serif"><title>{escape(title)}</title>{content}</svg>'
    )
