"""A change in words, with its size and what to do about it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.posing.condition import Held, Sightings, conditioned
from sunarc.calibration.posing.seen import finite
from sunarc.calibration.posing.stated import predicted
from sunarc.calibration.watching.values import Change, ChangeKind
from sunarc.calibration.watching.window import Window

if TYPE_CHECKING:
    from sunarc.calibration.watching.explain import Explanation

FloatArray = NDArray[np.float64]

_SECOND_RAD = 7.292e-5

REMEDIES: dict[ChangeKind, str] = {
    "bump": "nothing, if the camera stays as it is: it is posed anew by itself; otherwise look at its mount",
    "clock": "let a time service set the host's clock; the calibration is kept, sightings meanwhile are left out",
    "lens": "nothing, if a lens was changed or focused: it is calibrated anew from the next clear days",
    "mirrored": "set the camera's image back as it was (reverse X, reverse Y); sightings meanwhile are left out",
    "site": "correct the sign of site.latitude or site.longitude in the settings; sightings meanwhile are left out",
}


def told(window: Window, explanation: Explanation, held: Held, *, gain: float, alike: list[int]) -> Change:
    """Return the change that an explanation amounts to.

    Parameters
    ----------
    window, explanation, held : the sightings, what explains them, and what they say of it.
    gain : powers of e by which it is better than none.
    alike : first sightings after a change that explain nearly as well.
    """
    first, times = explanation.first, window.watch.unix_s
    sure = first + int(np.argmax(held.believed[first:]))
    early, late = min([first, *alike]), max([sure, *alike])
    size, sigma = _size(window, explanation, held)
    agreeing = int(held.believed[first:].sum())
    of = len(window.watch) - first
    return Change(
        kind=explanation.kind,
        at_unix_s=float(times[sure]),
        earliest_unix_s=float(times[early - 1]) if early > 0 else float(times[0]),
        latest_unix_s=float(times[late]),
        size=size,
        size_sigma=sigma,
        unit="s" if explanation.kind == "clock" else "degrees",
        gain=gain,
        agreeing=agreeing,
        of=of,
        text=f"{_what(explanation.kind, size, sigma)}; {agreeing} of {of} sightings since agree",
        remedy=REMEDIES[explanation.kind],
    )


def _what(kind: ChangeKind, size: float, sigma: float) -> str:
    if kind == "bump":
        return f"the camera turned by {size:.3f} ± {sigma:.3f} degrees"
    if kind == "clock":
        return f"the clock that dates the frames jumped by {size:+.2f} ± {sigma:.2f} s"
    if kind == "lens":
        return "the lens is not what it was: another one, or refocused, or shifted against the sensor"
    if kind == "mirrored":
        return "the image is mirrored against what it was"
    return "the sun is where it would be at a site with the opposite latitude or longitude"


def _size(window: Window, explanation: Explanation, held: Held) -> tuple[float, float]:
    """Return how far the camera turned in degrees, or the clock jumped in seconds, with its 1-sigma."""
    if explanation.kind not in ("bump", "clock"):
        return 0.0, 0.0
    axes = explanation.free[window.belief.turn]
    scale = float(np.linalg.norm(axes[:, 0]))
    base = -explanation.mean[window.belief.turn]
    at = predicted(window.belief, explanation.camera, explanation.directions)
    believed = held.believed[explanation.first :]
    noise = window.seen.variance[explanation.first :][believed]
    seen = Sightings(
        residual=finite(explanation.pixels - at.pixels)[believed], variance=noise, false_density=0.0 * noise
    )
    after = conditioned(window.belief.turned_freely(-base, sigma_rad=scale), at.select(believed), seen)
    turn = base + after.mean[window.belief.turn]
    covariance = after.covariance[np.ix_(window.belief.turn, window.belief.turn)]
    if explanation.kind == "clock":
        pole = axes[:, 0] / scale
        return float(turn @ pole) / -_SECOND_RAD, math.sqrt(float(pole @ covariance @ pole)) / _SECOND_RAD
    length = float(np.linalg.norm(turn))
    along = turn / max(length, 1e-12)
    return math.degrees(length), math.degrees(math.sqrt(max(float(along @ covariance @ along), 0.0)))
