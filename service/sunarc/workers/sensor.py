"""Sensor properties from the settings, in a frame's counts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Gt, Le, Lt

from sunarc.bounds import require_bounds
from sunarc.cameras.frame import Frame
from sunarc.detection.values import Sensor, bayer_of


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorOptions:
    """The sensor's noise.

    Attributes
    ----------
    full_well_e : electrons at full scale.
    read_noise_e : electrons.
    black_level_fraction : level of an unlit pixel, of full scale.
    blooming : a saturated pixel spills into its neighbours.
    """

    full_well_e: Annotated[float, Gt(0.0), Le(1e7)] = 20_000.0
    read_noise_e: Annotated[float, Ge(0.0), Le(1e6)] = 12.0
    black_level_fraction: Annotated[float, Ge(0.0), Lt(1.0)] = 0.0
    blooming: bool = False

    def __post_init__(self) -> None:
        """Refuse what no sensor has."""
        require_bounds(self, section="sensor")


def sensor_of(frame: Frame, options: SensorOptions) -> Sensor:
    """Return the sensor's properties for the detector and the merge, by a frame's pixel format and binning.

    The mean of n² pixels has the noise of n² times the electrons per count; a raised gain has fewer.
    """
    raised = 10.0 ** (frame.raised_db / 20.0)
    return Sensor(
        full_scale=frame.full_scale,
        gain_e_per_count=frame.binning**2 * options.full_well_e / frame.full_scale / raised,
        read_noise_e=frame.binning * options.read_noise_e,
        black_level=options.black_level_fraction * frame.full_scale,
        bayer=bayer_of(frame.pixel_format),
        blooming=options.blooming,
        binning=frame.binning,
    )
