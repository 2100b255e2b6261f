"""Pose of a known lens from a few sightings, some of which may be outliers.

`estimate_pose` the calibration of the new pose · `error_model` the calibration's errors as a Gaussian · `residuals`
sightings and their noise · `rotation_consensus` RANSAC · `gaussian_conditioning` the posterior · `daily_offset` per
day · `stated_prior` lens and pose about a camera that is stated with tolerances.
"""
