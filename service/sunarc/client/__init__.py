"""Python client of the HTTP service on numpy alone; imports nothing else of this package.

It is also a distribution of its own, `sunarc-client`, whose package is `sunarc_client`: hence the relative imports.
`imager` the requests · `asynchronous` the same to be awaited · `hub` those to a hub · `local`, `camera` a calibration
evaluated without the service · `answers` values and events · `transport` retries · `xarray_accessor`
images as xarray, where that is installed.
"""

from .answers import BackProjection, Condition, Finding, ImagerEvent, Located, Projection
from .asynchronous import AsyncImager
from .camera import CameraModel
from .hub import Hub
from .imager import Imager
from .local import LocalImager
from .transport import ImagerError

__all__ = [
    "AsyncImager",
    "BackProjection",
    "CameraModel",
    "Condition",
    "Finding",
    "Hub",
    "Imager",
    "ImagerError",
    "ImagerEvent",
    "LocalImager",
    "Located",
    "Projection",
]
