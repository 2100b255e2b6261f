"""Did something change? Every sighting against the calibration, and what explains those that disagree.

Map: `values` what is told, remembered and found · `window` sightings held to a calibration · `update_window` one more of them
· `best_hypothesis` the explanations, weighed · `tell` the one that is named, in words.
"""

from sunarc.calibration.change_detection.detect_change import REMEMBERED, update_window
from sunarc.calibration.change_detection.values import (
    LENS_KINDS,
    Change,
    ChangeKind,
    Sighting,
    SightingWindow,
    WatchOptions,
)

__all__ = [
    "LENS_KINDS",
    "REMEMBERED",
    "Change",
    "ChangeKind",
    "Sighting",
    "SightingWindow",
    "WatchOptions",
    "update_window",
]
