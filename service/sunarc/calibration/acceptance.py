"""Whether a fit may be used at all, and whether it may take the place of the current one."""

from __future__ import annotations

import math

import numpy as np

from sunarc.calibration.covariance import hemisphere, project_with_covariance
from sunarc.calibration.result import Calibration, Verdict
from sunarc.optics import project

_WORSE = 1.15
_FAR_SIGMAS = 5.0
_SHOWN = 0.5


def accept(candidate: Calibration, current: Calibration | None = None, *, same_pose: bool = True) -> Verdict:
    """Return whether a candidate may become the current calibration.

    It may where its own verdict allows, where it is not less sure of the sky than the current one, where it does not
    meet its own sightings worse than the scatter allows, and where the two agree within what they say of themselves.

    Parameters
    ----------
    candidate : the new fit.
    current : the one in use; None where there is none.
    same_pose : whether both speak of the same pose epoch; if not, agreement is not asked for.
    """
    if not candidate.verdict.accepted:
        return Verdict(accepted=False, reasons=candidate.verdict.reasons)
    if current is None:
        return Verdict(accepted=True, reasons=("the first calibration", *candidate.verdict.reasons))
    before, now = current.sky_rms_deg, candidate.sky_rms_deg
    if not now <= _WORSE * before:
        return Verdict(
            accepted=False, reasons=(f"less sure of the sky: 1-sigma {now:.4f} against {before:.4f} degrees",)
        )
    if same_pose:
        share, worst_px = disagreement(candidate, current)
        if share > _SHOWN:
            where = f"{100 * share:.0f} % of the sky contradicts the current one, by up to {worst_px:.2f} px"
            return Verdict(accepted=False, reasons=(f"{where}: the camera may have moved",))
    return Verdict(accepted=True, reasons=(f"surer of the sky: 1-sigma {now:.4f} against {before:.4f} degrees",))


def distance_px(first: Calibration, second: Calibration) -> float:
    """Return how far two cameras are apart at most over the sky that both see, px; infinite where they share none."""
    directions = hemisphere()
    apart = np.linalg.norm(project(first.camera, directions) - project(second.camera, directions), axis=-1)
    return float(np.nanmax(apart)) if np.any(np.isfinite(apart)) else math.inf


def disagreement(first: Calibration, second: Calibration) -> tuple[float, float]:
    """Return the share of the sky over which two calibrations contradict each other, and their largest distance in px.

    They contradict where their distance is beyond five of their joint sigmas.
    """
    directions = hemisphere(400)
    a, a_covariance = project_with_covariance(first, directions)
    b, b_covariance = project_with_covariance(second, directions)
    both = np.all(np.isfinite(a), axis=-1) & np.all(np.isfinite(b), axis=-1)
    if not np.any(both):
        return 1.0, math.inf
    apart = (a - b)[both]
    joint = (a_covariance + b_covariance)[both] + 1e-12 * np.eye(2)
    square = np.einsum("ni,ni->n", apart, np.linalg.solve(joint, apart[..., None])[..., 0])
    return float(np.mean(square > _FAR_SIGMAS**2)), float(np.max(np.linalg.norm(apart, axis=-1)))
