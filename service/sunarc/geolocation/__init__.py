"""Where a cloud and its shadow stand on the ground, and how sure that is.

ellipsoid.py: places on the WGS 84 ellipsoid · locate.py: from directions and a height to clouds and shadows.
"""

from sunarc.geolocation.ellipsoid import Place, place_of
from sunarc.geolocation.locate import Located, clouds, shadows

__all__ = ["Located", "Place", "clouds", "place_of", "shadows"]
