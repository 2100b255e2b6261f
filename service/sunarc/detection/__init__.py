"""Detection of the sun: `disc` in microsecond exposures, `photo` in ordinary ones; `stars` and `moon` at night."""

from sunarc.detection.disc.bracket import beside, combine
from sunarc.detection.disc.brightness import ClearSun, clear_sun
from sunarc.detection.disc.detect import detect_sun
from sunarc.detection.moon.cutouts import Cutout, brightest_cutouts, cutout_around
from sunarc.detection.moon.detect import detect_moon
from sunarc.detection.moon.values import MoonDetection, MoonExpectation
from sunarc.detection.options import DiscOptions
from sunarc.detection.photo.blob_bias import Lens, radial_bias_px
from sunarc.detection.photo.exposure_stack import Exposure, detect_sun_in_stack
from sunarc.detection.photo.ordinary_image import detect_sun_in_photo
from sunarc.detection.photo.static_mask import static_mask
from sunarc.detection.photo.urquhart2016 import Estimates, Planes, locate, planes_of
from sunarc.detection.stars.completeness import (
    ZENITH_BANDS_DEG,
    ZenithBand,
    detected,
    limiting_magnitude,
    zenith_bands,
)
from sunarc.detection.stars.detect import detect_stars
from sunarc.detection.stars.extinction import Extinction, StarLight, extinction_of
from sunarc.detection.stars.halo import star_halo
from sunarc.detection.stars.matching import StarMatches, match_stars
from sunarc.detection.stars.still import sky_motion, standing_still
from sunarc.detection.stars.trend import NightLimits, NightTrend, dew_suspected, focus_ratio, trend_of
from sunarc.detection.stars.values import FWHM, MOST_PEAK, PredictedStars, Stars
from sunarc.detection.stars.warm import outstanding_pixels, repaired, warm_pixels
from sunarc.detection.values import BAYERS, Bayer, Detection, Expectation, Method, Sensor, Verdict, bayer_of

__all__ = [
    "BAYERS",
    "FWHM",
    "MOST_PEAK",
    "ZENITH_BANDS_DEG",
    "Bayer",
    "ClearSun",
    "Cutout",
    "Detection",
    "DiscOptions",
    "Estimates",
    "Expectation",
    "Exposure",
    "Extinction",
    "Lens",
    "Method",
    "MoonDetection",
    "MoonExpectation",
    "NightLimits",
    "NightTrend",
    "Planes",
    "PredictedStars",
    "Sensor",
    "StarLight",
    "StarMatches",
    "Stars",
    "Verdict",
    "ZenithBand",
    "bayer_of",
    "beside",
    "brightest_cutouts",
    "clear_sun",
    "combine",
    "cutout_around",
    "detect_moon",
    "detect_stars",
    "detect_sun",
    "detect_sun_in_photo",
    "detect_sun_in_stack",
    "detected",
    "dew_suspected",
    "extinction_of",
    "focus_ratio",
    "limiting_magnitude",
    "locate",
    "match_stars",
    "outstanding_pixels",
    "planes_of",
    "radial_bias_px",
    "repaired",
    "sky_motion",
    "standing_still",
    "star_halo",
    "static_mask",
    "trend_of",
    "warm_pixels",
    "zenith_bands",
]
