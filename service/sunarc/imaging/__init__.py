"""Exposure control for the sun, checks of frame brightness, and the HDR merge; pure functions."""

from sunarc.imaging.brightness import Exposed, light_ratio_contradiction
from sunarc.imaging.darkness import is_dark
from sunarc.imaging.exposure import (
    ExposureBounds,
    Peak,
    SunExposureOptions,
    SunExposureState,
    SunLook,
    first_sun_exposures,
    next_sun_exposures,
)
from sunarc.imaging.hdr import HdrImage, merge_hdr
from sunarc.imaging.level import MOST_ALL_OVER, Level, factor_all_over, level_of
from sunarc.imaging.metadata import document_of, jpeg_with, png_with
from sunarc.imaging.preview import demosaiced, preview

__all__ = [
    "MOST_ALL_OVER",
    "Exposed",
    "ExposureBounds",
    "HdrImage",
    "Level",
    "Peak",
    "SunExposureOptions",
    "SunExposureState",
    "SunLook",
    "demosaiced",
    "document_of",
    "factor_all_over",
    "first_sun_exposures",
    "is_dark",
    "jpeg_with",
    "level_of",
    "light_ratio_contradiction",
    "merge_hdr",
    "next_sun_exposures",
    "png_with",
    "preview",
]
