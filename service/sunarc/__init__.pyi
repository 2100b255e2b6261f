from .common.errors import InputError as InputError
from .formats.view import Comparison as Comparison
from .public.calibration import Calibration as Calibration
from .public.calibration import Draws as Draws
from .public.calibration import compare as compare
from .public.calibration import load as load
from .public.fit import calibrate as calibrate
from .public.images import StarDetections as StarDetections
from .public.images import SunDetection as SunDetection
from .public.images import find_stars as find_stars
from .public.images import find_sun as find_sun
from .public.values import CloudPositions as CloudPositions
from .public.values import Directions as Directions
from .public.values import PixelPositions as PixelPositions
from .public.values import Sightings as Sightings
from .public.values import Site as Site
from .public.values import SunPosition as SunPosition
from .public.values import read_sightings as read_sightings
from .public.values import sun_position as sun_position

__all__ = [
    "Calibration",
    "CloudPositions",
    "Comparison",
    "Directions",
    "Draws",
    "InputError",
    "PixelPositions",
    "Sightings",
    "Site",
    "StarDetections",
    "SunDetection",
    "SunPosition",
    "calibrate",
    "compare",
    "find_stars",
    "find_sun",
    "load",
    "read_sightings",
    "sun_position",
]
__version__: str
