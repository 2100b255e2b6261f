"""A camera without a calibration: its lens and pose by one night's turning sky and the bright stars.

`turning` the lens, the pole and the hand by what moves · `phase` the angle about the pole by the bright catalogue ·
`refinement` the camera by the stars · `start` the entry, with the other hypotheses beside it.
"""
