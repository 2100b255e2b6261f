"""The accessor of images: directions by pixel, values by direction, positions of clouds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import ArrayLike
from tests.fixtures.served import document

from sunarc.client import CameraModel, Imager, Located

xr = pytest.importorskip("xarray")
pytest.importorskip("sunarc.client.xarray_accessor")


@pytest.fixture(scope="module")
def camera() -> CameraModel:
    return CameraModel(document("one"))


@pytest.fixture
def image() -> Any:  # noqa: ANN401 - of xarray
    """Return every fiftieth pixel of an image of two times, whose value is x + 2 y."""
    x, y = np.arange(0, 1748, 50), np.arange(0, 1748, 50)
    values = x[None, :] + 2.0 * y[:, None]
    return xr.DataArray([values, values + 1.0], dims=("time", "y", "x"), coords={"x": x, "y": y})


def test_pixels_have_the_directions_of_the_calibration(image: Any, camera: CameraModel) -> None:  # noqa: ANN401
    found = image.sunarc.with_directions(camera)
    at = found.sel(x=900, y=700)
    expected = camera.back_project([900.0, 700.0])
    for name, value in (
        ("zenith", expected.zenith_deg),
        ("azimuth", expected.azimuth_deg),
        ("sigma", expected.sigma_deg),
    ):
        assert float(at[name]) == pytest.approx(float(value), rel=1e-8)  # solved to some digits
    assert np.isnan(float(found.sel(x=0, y=0).zenith))  # a corner
    assert (found.zenith.dims, found.attrs["calibration"], found.zenith.attrs["units"]) == (("y", "x"), "one", "degree")
    xr.testing.assert_equal(found.drop_vars(["zenith", "azimuth", "sigma"]), image.assign_attrs(calibration="one"))


def test_the_sky_is_read_by_direction(image: Any, camera: CameraModel) -> None:  # noqa: ANN401
    zenith, azimuth = np.array([5.0, 40.0, 70.0, 120.0]), np.array([0.0, 100.0, 250.0, 0.0])
    found = image.sunarc.towards(camera, zenith_deg=zenith, azimuth_deg=azimuth)
    assert (found.dims, found.zenith.values.tolist()) == (("time", "direction"), zenith.tolist())
    pixels = camera.project(
        np.stack(
            [
                np.sin(np.radians(zenith)) * np.sin(np.radians(azimuth)),
                np.sin(np.radians(zenith)) * np.cos(np.radians(azimuth)),
                np.cos(np.radians(zenith)),
            ],
            axis=-1,
        )
    ).pixels
    np.testing.assert_allclose(found[0, :3], (pixels[:, 0] + 2.0 * pixels[:, 1])[:3], atol=1e-6)
    np.testing.assert_allclose(found[1] - found[0], [1.0, 1.0, 1.0, np.nan], atol=1e-9)


def test_an_image_without_coordinates_begins_at_the_first_pixel(camera: CameraModel) -> None:
    plain = xr.DataArray(np.zeros((1748, 3)), dims=("y", "x")).isel(y=slice(870, 872))
    found = plain.sunarc.with_directions(camera)
    assert found.x.values.tolist() == [0, 1, 2]


@dataclass
class _Locating:
    asked: list[tuple[tuple[int, ...], float]]

    def geolocate(self, pixels: ArrayLike, *, height_m: float) -> tuple[Located, None]:
        shape = np.shape(pixels)[:-1]
        self.asked.append((shape, height_m))
        x, y = np.moveaxis(np.asarray(pixels), -1, 0)
        return Located(np.zeros((*shape, 3)), x, y, x * 0.0, x + y, np.zeros((*shape, 2, 2))), None


def test_clouds_have_positions(image: Any) -> None:  # noqa: ANN401
    imager = _Locating([])
    found = image.sunarc.with_positions(cast("Imager", imager), height_m=1500.0)
    assert imager.asked == [((35, 35), 1500.0)]
    at = found.sel(x=100, y=50)
    assert [float(at[name]) for name in ("latitude", "longitude", "sigma_m")] == [100.0, 50.0, 150.0]


def test_an_image_of_other_dimensions_is_refused() -> None:
    with pytest.raises(ValueError, match=r"\bx\b.*\by\b"):
        xr.DataArray(np.zeros((3, 3)), dims=("row", "column")).sunarc  # noqa: B018 - to look at it is to make it
