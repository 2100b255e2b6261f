"""Positions of a cloud and its shadow on the ground, with their covariance.

`ellipsoid` WGS 84 · `locate` from directions and a height · `pair_height` from the directions of two cameras.
"""

from sunarc.geolocation.ellipsoid import GeodeticPosition, geodetic_position
from sunarc.geolocation.locate import Located, clouds, shadows
from sunarc.geolocation.pair_height import PairHeight, View, pair_height

__all__ = ["GeodeticPosition", "Located", "PairHeight", "View", "clouds", "geodetic_position", "pair_height", "shadows"]
