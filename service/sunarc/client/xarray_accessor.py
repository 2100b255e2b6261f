"""Images as xarray: directions, cloud positions and the sky by direction, as the accessor `sunarc` of a DataArray.

Importing this module registers the accessor; it needs xarray (`sunarc-client[xarray]`).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from .answers import BackProjection, FloatArray, Projection
from .imager import Imager


class Projecting(Protocol):
    """Object that takes pixels to directions and back: `Imager`, `LocalImager` or `CameraModel`."""

    def back_project(self, pixels: ArrayLike, /) -> BackProjection:
        """Return the directions of pixels (..., 2)."""

    def project(self, direction: ArrayLike, /) -> Projection:
        """Return where vectors (..., 3) land."""


@xr.register_dataarray_accessor("sunarc")
class SunarcAccessor:
    """Directions and positions of the sky in an image.

    Parameters
    ----------
    image : with the dimensions y and x, and any others. Its coordinates x and y are pixels, the centre of the top-left
        one (0, 0); where it has none they are counted from there.
    """

    def __init__(self, image: xr.DataArray) -> None:
        missing = {"x", "y"} - set(image.dims)
        if missing:
            raise ValueError(f"the image has no dimension {' and '.join(sorted(missing))}; rename those it has")
        axes = {name: np.arange(image.sizes[name]) for name in ("y", "x") if name not in image.coords}
        self._image = image.assign_coords(axes)

    def with_directions(self, camera: Projecting) -> xr.DataArray:
        """Return the image with the coordinates zenith, azimuth and sigma (y, x), degrees; NaN outside the field."""
        seen = camera.back_project(self._make_pixel_grid())
        named = {"zenith": seen.zenith_deg, "azimuth": seen.azimuth_deg, "sigma": seen.sigma_deg}
        columns = {
            name: (("y", "x"), np.where(seen.inside, values, np.nan), {"units": "degree"})
            for name, values in named.items()
        }
        return self._image.assign_coords(columns).assign_attrs(calibration=seen.calibration)

    def with_positions(self, imager: Imager, *, height_m: float) -> xr.DataArray:
        """Return the image with latitude, longitude and sigma_m (y, x) of clouds at a height; NaN elsewhere.

        Every pixel is asked for: select part of the image, or every tenth pixel, before.
        """
        cloud, _ = imager.geolocate(self._make_pixel_grid(), height_m=height_m)
        columns = {
            "latitude": (("y", "x"), cloud.latitude, {"units": "degrees_north"}),
            "longitude": (("y", "x"), cloud.longitude, {"units": "degrees_east"}),
            "sigma_m": (("y", "x"), cloud.sigma_m, {"units": "m"}),
        }
        return self._image.assign_coords(columns)

    def towards(self, camera: Projecting, *, zenith_deg: ArrayLike, azimuth_deg: ArrayLike) -> xr.DataArray:
        """Return the image's values in directions (n,), interpolated linearly, along `direction`; NaN outside of it."""
        zenith, azimuth = np.radians(zenith_deg), np.radians(azimuth_deg)
        across = np.sin(zenith)
        vectors = np.stack([across * np.sin(azimuth), across * np.cos(azimuth), np.cos(zenith)], axis=-1).reshape(-1, 3)
        found = camera.project(vectors)
        x, y = (np.where(found.inside, column, np.nan) for column in found.pixels.T)
        values = self._image.astype(np.float64).interp(x=("direction", x), y=("direction", y))
        angles = {"zenith": np.ravel(zenith_deg), "azimuth": np.ravel(azimuth_deg)}
        return values.assign_coords({name: ("direction", value, {"units": "degree"}) for name, value in angles.items()})

    def _make_pixel_grid(self) -> FloatArray:
        """Return (y, x, 2)."""
        x, y = (np.asarray(self._image[name], dtype=np.float64) for name in ("x", "y"))
        return np.stack(np.meshgrid(x, y), axis=-1)
