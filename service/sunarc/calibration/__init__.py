"""Fit of a camera to sightings of the sun: the camera, its uncertainty and a verdict.

`calibrate` the entry · `batch` many fits of one geometry · `model` values · `selection` of sightings ·
`initial_guess`, `least_squares`, `fit` the robust fit · `paper` the reference method · `quality` verdicts · `pose` a
known lens in a new pose · `change_detection` comparison of every sighting with the calibration · `ensemble` joint
draws of the errors · `pose_change_points`, `pose_step_search`, `pose_step_evidence` pose changes within a record ·
`projection_choice` the projection of an unknown lens · `lens_library` types of lens, joint fits, first poses ·
`star_prediction` pixels of the stars · `blind_start` a camera by the stars ·
`reproduce` a stored fit again. The maths: docs/maths.md.
"""
