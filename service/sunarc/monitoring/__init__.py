"""A calibration in use: whether camera, clock and site are as before, and whether a refit takes its place."""
