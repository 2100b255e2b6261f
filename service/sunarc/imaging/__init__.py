"""What to expose for the sun, and what to keep of a cycle: all pure.

Map: `exposure` the sun exposure controller, `brightness` whether frames had their exposures, `hdr` the merge, `preview`
for people.
"""

from sunarc.imaging.brightness import Exposed, light_ratio_contradiction
from sunarc.imaging.exposure import (
    ExposureBounds,
    Peak,
    SunExposureOptions,
    SunExposureState,
    first_sun_exposures,
    next_sun_exposures,
)
from sunarc.imaging.hdr import HdrImage, merge_hdr
from sunarc.imaging.preview import preview

__all__ = [
    "Exposed",
    "ExposureBounds",
    "HdrImage",
    "Peak",
    "SunExposureOptions",
    "SunExposureState",
    "first_sun_exposures",
    "light_ratio_contradiction",
    "merge_hdr",
    "next_sun_exposures",
    "preview",
]
