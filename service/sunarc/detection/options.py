"""Options of the two methods, with their bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

from annotated_types import Ge, Gt, Le, Lt

from sunarc.bounds import NonNegative, Positive, Share, require_bounds


@dataclass(frozen=True, slots=True, kw_only=True)
class DiscOptions:
    """Limits of the search and of the classification in microsecond frames.

    `psf_px`, `min_radius_px` and `max_radius_px` are in pixels of the sensor, before the camera's binning.

    Attributes
    ----------
    psf_px : standard deviation of the lens's point spread, px.
    psf_tolerance : 1-sigma of its logarithm; the fit moves it that far.
    wings_tolerance : 1-sigma of the share of light in wings three times as wide.
    limb_darkening : u of 1 - u (1 - cos) across the sun's disc.
    solar_radius_deg : the sun's angular radius.
    saturation_fraction : counts from this fraction of full scale on are saturated.
    min_peak_fraction : level over full scale below which no disc is searched for.
    min_accepted_fraction : level below which a disc is rejected: a partly covered one would look the same.
    min_snr : signal-to-noise ratio below which the sun counts as hidden.
    min_radius_px, max_radius_px : bounds of the semi-axes of a disc without a prediction.
    max_ellipticity : largest 1 - minor/major semi-axis of such a disc.
    max_uneven_px : a disc whose uneven brightness may have moved the centre further is partly covered.
    max_residual_fraction : so is a disc with larger residuals over its level.
    max_sigma_px : a less certain position is not accepted.
    veiled_below : a disc below this fraction of the clear sky's is veiled; so is one below this contrast.
    max_apparent_zenith_deg : a lower sun is below the horizon.
    clear_level_per_us : the clear sun's level over full scale in 1 µs, at the gain in use; 0 where unknown. The
        reference for the brightness where the prediction has none.
    faintest_share : fraction of that level below which a disc is not the sun; the full moon has 2.5e-6.
    faintest_level_per_us : where the clear level is unknown, a disc without a prediction and with less than this
        level over full scale in 1 µs is not the sun. Through a bare lens the sun has 0.1 to 10, the full moon 1e-7 to
        3e-5; behind a filter of density 4 or more set this, or better `clear_level_per_us`, to what the filter leaves.
    """

    psf_px: Annotated[float, Gt(0.0), Le(20.0)] = 0.7
    psf_tolerance: Positive = 0.3
    wings_tolerance: Positive = 0.05
    limb_darkening: Share = 0.6
    solar_radius_deg: Annotated[float, Gt(0.0), Le(1.0)] = 0.2666
    saturation_fraction: Annotated[float, Gt(0.0), Le(1.0)] = 0.98
    min_peak_fraction: Share = 0.01
    min_accepted_fraction: Share = 0.07
    min_snr: Annotated[float, Gt(0.0), Le(1e4)] = 12.0
    min_radius_px: Positive = 1.2
    max_radius_px: Positive = 10.0
    max_ellipticity: Annotated[float, Gt(0.0), Lt(1.0)] = 0.6
    max_uneven_px: Positive = 0.03
    max_residual_fraction: Positive = 0.02
    max_sigma_px: Positive = 0.06
    veiled_below: Share = 0.5
    max_apparent_zenith_deg: Annotated[float, Gt(0.0), Le(92.0)] = 89.6
    clear_level_per_us: Annotated[float, Ge(0.0), Le(1e6)] = 0.0
    faintest_share: Share = 1e-4
    faintest_level_per_us: NonNegative = 1e-4

    def __post_init__(self) -> None:
        """Refuse values out of bounds."""
        require_bounds(self, section="detection")

    def binned(self, binning: int) -> DiscOptions:
        """Return the same options in the pixels of an image whose camera joins so many in either direction."""
        if binning == 1:
            return self
        return replace(
            self,
            psf_px=self.psf_px / binning,
            min_radius_px=self.min_radius_px / binning,
            max_radius_px=self.max_radius_px / binning,
        )
