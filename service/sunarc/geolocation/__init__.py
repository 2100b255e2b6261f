"""Positions of a cloud and its shadow on the ground, with their covariance.

`locate` from directions and a height, on WGS 84 · `pair_height` from the directions of two cameras.
"""
