"""The moon as predicted, and as found."""

from __future__ import annotations

from dataclasses import dataclass

from sunarc.array_types import FloatArray
from sunarc.findings import Finding


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MoonExpectation:
    """Where and how the moon should be in an image.

    Attributes
    ----------
    x_px, y_px : predicted pixel of the disc's centre; (0, 0) is the centre of the top-left pixel.
    uncertainty_px : 1-sigma per axis of the prediction.
    edges_px : (2, 2) px: the first column leads from the centre to the middle of the lit limb, the second to the limb a
        quarter of the circle onwards.
    cos_phase : cosine of the phase angle: 1 is full, 0 half, -1 new.
    """

    x_px: float
    y_px: float
    uncertainty_px: float
    edges_px: FloatArray
    cos_phase: float


@dataclass(frozen=True, slots=True, kw_only=True)
class MoonDetection:
    """Result of looking for the moon in one image.

    Attributes
    ----------
    accepted : whether fits may use the position.
    findings : what decided, as codes and data; the first is the main one.
    x_px, y_px : centre of the whole disc, lit or not; None where none was found. A rejected position may be given.
    sigma_px : 1-sigma per axis.
    level : brightness of the lit part over full scale, by the fit: above 1 where it is clipped.
    snr : light of the lit part over its standard deviation.
    chi2 : reduced chi² of the fit.
    residual : rms of the fit's residuals over the level.
    haze : light of the sky 1 px outside of the blurred disc over the disc's, above the sky farther off.
    width_px : 1-sigma of the point spread.
    saturated_px : clipped pixels, which took no part.
    """

    accepted: bool
    findings: tuple[Finding, ...]
    x_px: float | None = None
    y_px: float | None = None
    sigma_px: float | None = None
    level: float | None = None
    snr: float | None = None
    chi2: float | None = None
    residual: float | None = None
    haze: float | None = None
    width_px: float | None = None
    saturated_px: int = 0
