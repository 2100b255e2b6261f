"""A change as a finding, with its size."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sunarc.calibration.change_detection.residual_model import ResidualModel
from sunarc.calibration.change_detection.values import Change, ChangeKind, Hypothesis
from sunarc.calibration.pose.error_model import CameraErrorModel, predicted
from sunarc.calibration.pose.gaussian_conditioning import MixtureFit, Sightings, conditioned
from sunarc.calibration.robust_loss import finite
from sunarc.findings import Data, Finding
from sunarc.optics.camera import Param

_SECOND_RAD = 7.292e-5
_FOCAL, _CENTER = Param.FOCAL_LENGTH_X_PX, (Param.PRINCIPAL_POINT_X_PX, Param.PRINCIPAL_POINT_Y_PX)
_UNITS: dict[ChangeKind, str] = {"clock": "s", "refocus": "%", "shift": "px"}
_PERHAPS: dict[ChangeKind, str] = {
    "lens": "another lens",
    "refocus": "a refocused lens",
    "shift": "a sensor that shifted behind the lens",
}


def describe_change(
    window: ResidualModel,
    explanation: Hypothesis,
    mixture: MixtureFit,
    *,
    gain: float,
    alike: list[int],
    perhaps: tuple[ChangeKind, ...] = (),
) -> Change:
    """Return the change that an explanation amounts to.

    Parameters
    ----------
    window, explanation, mixture : the sightings, what explains them, and what they say of it.
    gain : powers of e by which it is better than none.
    alike : first sightings after a change that explain nearly as well.
    perhaps : other kinds that do.
    """
    first, times = explanation.first, window.watch.unix_s
    sure = first + int(np.argmax(mixture.inlier[first:]))
    early, late = min([first, *alike]), max([sure, *alike])
    size, sigma = _size(window, explanation, mixture)
    agreeing = int(mixture.inlier[first:].sum())
    of = len(window.watch) - first
    data: Data = {"size": size, "sigma": sigma, "agreeing": agreeing, "of": of, "alternatives": _alternatives(perhaps)}
    return Change(
        kind=explanation.kind,
        at_unix_s=float(times[sure]),
        earliest_unix_s=float(times[early - 1]) if early > 0 else float(times[0]),
        latest_unix_s=float(times[late]),
        size=size,
        size_sigma=sigma,
        unit=_UNITS.get(explanation.kind, "degrees"),
        gain=gain,
        agreeing=agreeing,
        of=of,
        perhaps=", ".join(perhaps),
        finding=Finding(f"changed_{explanation.kind}", data),
    )


def _alternatives(perhaps: tuple[ChangeKind, ...]) -> str:
    return f" (or {', or '.join(_PERHAPS[kind] for kind in perhaps)}: cannot be distinguished yet)" if perhaps else ""


def _size(window: ResidualModel, explanation: Hypothesis, mixture: MixtureFit) -> tuple[float, float]:
    """Return how large a change is, in its unit, with its 1-sigma; 0 where that has no meaning."""
    names, rotation = list(window.error_model.selected), window.error_model.rotation
    if explanation.kind not in ("bump", "clock", "refocus", "shift") or not {_FOCAL, *_CENTER} <= set(names):
        return 0.0, 0.0
    after = _after(window, explanation, mixture)
    change = after.mean.copy()
    change[rotation] -= explanation.mean[rotation]
    axis, unit = np.zeros(change.size), 1.0
    if explanation.kind == "clock":
        axis, unit = explanation.free[:, 0] / np.linalg.norm(explanation.free[:, 0]), -1.0 / _SECOND_RAD
    elif explanation.kind == "refocus":
        axis[names.index(_FOCAL)], unit = 1.0, 100.0 / window.camera.focal_length_px[0]
    else:
        of = rotation if explanation.kind == "bump" else [names.index(i) for i in _CENTER]
        axis[of] = change[of] / max(float(np.linalg.norm(change[of])), 1e-12)
        unit = math.degrees(1.0) if explanation.kind == "bump" else 1.0
    sigma = math.sqrt(max(float(axis @ after.covariance @ axis), 0.0))
    return unit * float(axis @ change), abs(unit) * sigma


def _after(window: ResidualModel, explanation: Hypothesis, mixture: MixtureFit) -> CameraErrorModel:
    """Return the error model of the hypothesis's camera, conditioned on the sightings that agree with it."""
    free = explanation.free
    before = replace(
        window.error_model, mean=explanation.mean, covariance=window.error_model.covariance + free @ free.T
    )
    at = predicted(window.error_model, explanation.camera, explanation.directions)
    inlier = mixture.inlier[explanation.first :]
    noise = window.sightings.variance[explanation.first :][inlier]
    sightings = Sightings(
        residual=finite(explanation.pixels - at.pixels)[inlier], variance=noise, false_density=0.0 * noise
    )
    return conditioned(before, at.select(inlier), sightings)
