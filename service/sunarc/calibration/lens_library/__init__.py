"""Lenses of one type: what several cameras say of it, and what a fit or a pose gains from that.

`frame` the coordinates · `lens_type` what is known of a type, and its JSON · `combination` of several cameras ·
`conditioning` of a fit · `joint` fits of several cameras and epochs · `first_pose` from a few sightings ·
`mounting` azimuth and level of a camera.
"""

from sunarc.calibration.lens_library.combination import Unit, lens_type_of
from sunarc.calibration.lens_library.conditioning import with_lens
from sunarc.calibration.lens_library.first_pose import FirstPoseOptions, calibrate_with_lens, first_pose
from sunarc.calibration.lens_library.joint import Entry, Joint, calibrate_jointly
from sunarc.calibration.lens_library.lens_type import LENS_SCHEMA, LensType, UnitSpread, lens_type_from_json
from sunarc.calibration.lens_library.mounting import north_sigma_deg, top_azimuth_deg

__all__ = [
    "LENS_SCHEMA",
    "Entry",
    "FirstPoseOptions",
    "Joint",
    "LensType",
    "Unit",
    "UnitSpread",
    "calibrate_jointly",
    "calibrate_with_lens",
    "first_pose",
    "lens_type_from_json",
    "lens_type_of",
    "north_sigma_deg",
    "top_azimuth_deg",
    "with_lens",
]
