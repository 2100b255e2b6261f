"""Positions of a cloud and its shadow on the ground, with their covariance.

`ellipsoid` WGS 84 · `locate` from directions and a height · `pair_height` from the directions of two cameras.
"""
