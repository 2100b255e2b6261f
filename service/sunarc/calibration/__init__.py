"""Fit of a camera to sightings of the sun and the night sky: the camera, its uncertainty and a verdict.

`calibrate` the entry · `model` values · `answers` what a calibration says of pixels and directions · `selection` and
`noise` of sightings · `start` a first camera · `solve` least squares · `fit` the robust fit · `paper` the reference
method · `quality` verdicts · `pose` and `stated_prior` a lens that is known · `changes` of the pose, the clock, the
site · `projection_choice` the projection of an unknown lens · `lens_library` types of lens. The maths: docs/maths.md.
"""
