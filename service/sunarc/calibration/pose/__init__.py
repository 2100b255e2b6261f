"""Pose of a known lens from a few sightings, some of which may be outliers.

`estimate_pose` the calibration of the new pose · `error_model` the calibration's errors as a Gaussian · `residuals`
sightings and their noise · `rotation_consensus` RANSAC · `gaussian_conditioning` the posterior · `daily_offset` per
day · `stated_prior` lens and pose about a camera that is stated with tolerances.
"""

from sunarc.calibration.pose.daily_offset import PoseOffset, daily_pose_offset
from sunarc.calibration.pose.estimate_pose import estimate_pose
from sunarc.calibration.pose.stated_prior import PriorTolerances, calibrate_with_prior

__all__ = ["PoseOffset", "PriorTolerances", "calibrate_with_prior", "daily_pose_offset", "estimate_pose"]
