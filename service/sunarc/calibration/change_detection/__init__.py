"""Did something change? Every sighting against the calibration, and what explains those that disagree.

Map: `values` what is told, remembered and found · `window` sightings held to a calibration · `observe` one more of them
· `explain` the explanations, weighed · `tell` the one that is named, in words.
"""

from sunarc.calibration.change_detection.detect_change import REMEMBERED, observe
from sunarc.calibration.change_detection.values import LENS_KINDS, Change, ChangeKind, Watch, Watched, WatchOptions

__all__ = ["LENS_KINDS", "REMEMBERED", "Change", "ChangeKind", "Watch", "WatchOptions", "Watched", "observe"]
