"""Fit of a camera to sightings of the sun and the night sky: the camera, its uncertainty and a verdict.

`calibrate` the entry · `model` values · `answers` directions and pixels of a calibration · `selection` and
`noise` of sightings · `start` a first camera · `solve` least squares · `fit` the robust fit · `paper` the reference
method · `verdict` the table of checks, of the measures of `quality` and `acceptance` · `pose` and `stated_prior` a
lens that is known · `projection_choice` and `handedness` of an unknown lens · `lens_library` types of lens. The
maths: docs/maths.md.
"""
