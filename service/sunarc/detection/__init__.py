"""Where the sun is seen: in microsecond frames (`detect_sun`) and in ordinary images (the paper's estimators).

Map: `values` in and out, `options`; `search` finds bright spots, `window` cuts them out, `template` renders the disc,
`model`, `kernels` and `fit` fit it, `judge` says what it was and `obstruction` what is before it, `detect` joins them,
`bracket` a bracket's frames, and `brightness` learns how bright the clear sun is. For ordinary images: `estimators` and
`paper` are Appendix A, `blob` and `circles` the bright region's shape, `halo` the light around it, `bias` what its
centre is off, `photo` the verdict.
"""

from sunarc.detection.disc.bracket import beside, combine
from sunarc.detection.disc.brightness import ClearSun, clear_sun
from sunarc.detection.disc.detect import detect_sun
from sunarc.detection.options import DiscOptions
from sunarc.detection.photo.blob_bias import Lens, radial_bias_px
from sunarc.detection.photo.ordinary_image import PaperOptions, detect_sun_in_photo
from sunarc.detection.photo.urquhart2016 import Estimates, Planes, locate, planes_of
from sunarc.detection.values import BAYERS, Bayer, Detection, Expectation, Image, Method, Sensor, Verdict, bayer_of

__all__ = [
    "BAYERS",
    "Bayer",
    "ClearSun",
    "Detection",
    "DiscOptions",
    "Estimates",
    "Expectation",
    "Image",
    "Lens",
    "Method",
    "PaperOptions",
    "Planes",
    "Sensor",
    "Verdict",
    "bayer_of",
    "beside",
    "clear_sun",
    "combine",
    "detect_sun",
    "detect_sun_in_photo",
    "locate",
    "planes_of",
    "radial_bias_px",
]
