"""Comparison of neighbouring cameras: steps of a camera's pose, and clocks by the edges of clouds.

`rotation_steps` whose rotation changed, and what that may be: a clock, a longitude, north · `cloud_edges` how much
later one camera lost and found the sun than another · `clocks` the cameras' clocks from these lags. What follows from
what: docs/maths.md, section 13.
"""
