"""Positions of a cloud and its shadow on the ground, with their covariance.

`ellipsoid` WGS 84 · `locate` from directions and a height.
"""

from sunarc.geolocation.ellipsoid import GeodeticPosition, geodetic_position
from sunarc.geolocation.locate import Located, clouds, shadows

__all__ = ["GeodeticPosition", "Located", "clouds", "geodetic_position", "shadows"]
