"""Detection of a change of camera, clock or site by Bayesian model comparison of the last sightings.

`detect_change` one sighting more · `residual_model` the last sightings and the covariance of their residuals ·
`hypotheses` what may have changed · `cloud_drift` the rival that nothing has · `report` the change in words ·
`values` in and out.
"""

from sunarc.calibration.change_detection.detect_change import REMEMBERED, update_window
from sunarc.calibration.change_detection.hypotheses import pole_of
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
    "pole_of",
    "update_window",
]
