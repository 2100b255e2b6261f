"""Where the sun is seen: in microsecond frames (`detect_sun`) and in ordinary images (the paper's estimators).

Map: `values` in and out, `options`; `search` finds bright spots, `window` cuts them out, `template` renders the disc,
`model` and `fit` fit it, `judge` says what it was, `detect` joins them.
"""

from sunarc.detection.detect import detect_sun
from sunarc.detection.options import DiscOptions
from sunarc.detection.values import Bayer, Detection, Expectation, Image, Method, Sensor, Verdict, bayer_of

__all__ = [
    "Bayer",
    "Detection",
    "DiscOptions",
    "Expectation",
    "Image",
    "Method",
    "Sensor",
    "Verdict",
    "bayer_of",
    "detect_sun",
]
