from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.interpolate import RegularGridInterpolator
from tests.exports.conftest import FloatArray, worst_stated_px

from sunarc.calibration import from_document, unproject_with_sigma
from sunarc.exports import export, export_map
from sunarc.optics import Camera, project
from sunarc.sky import angles_from_direction


def opened(content: bytes) -> Any:  # noqa: ANN401 - of xarray
    return xr.load_dataset(io.BytesIO(content), engine="h5netcdf")


def test_the_map_opens_in_xarray_and_says_what_single_pixels_say(straight: dict[str, Any]) -> None:
    found = opened(export_map(straight, "netcdf"))
    assert found.attrs["Conventions"].startswith("CF-")
    assert "clockwise from north" in found.attrs["comment"]
    assert {name: found[name].attrs["units"] for name in ("zenith", "azimuth", "sigma", "direction")} == {
        "zenith": "degree", "azimuth": "degree", "sigma": "degree", "direction": "1",
    }  # fmt: skip
    camera = found[found["zenith"].attrs["camera_model"]]
    assert camera.attrs["projection"] == "equisolid"
    np.testing.assert_allclose(camera.attrs["principal_point_px"], [871.96, 803.0])
    pixels = np.random.default_rng(0).integers(0, 1600, (2000, 2))
    directions, sigma, _ = unproject_with_sigma(from_document(straight), pixels)
    zenith, azimuth = angles_from_direction(directions)
    at = found.isel(x=xr.DataArray(pixels[:, 0]), y=xr.DataArray(pixels[:, 1]))
    np.testing.assert_allclose(at["zenith"], zenith, atol=1e-4)
    assert np.nanmax(np.abs((at["azimuth"].values - azimuth + 180.0) % 360.0 - 180.0)) < 1e-4
    np.testing.assert_allclose(at["sigma"], sigma, atol=1e-4)
    np.testing.assert_allclose(
        at["direction"].isel(component=found["component_name"].values.tolist().index("up")), directions[:, 2], atol=1e-6
    )


@pytest.mark.parametrize("wanted", ["map", "calibration"])
def test_netcdf_keeps_the_rules_of_the_cf_conventions(straight: dict[str, Any], wanted: str) -> None:
    """CF 1.11: 2.6.2 (history), 3.4 (ancillary variables), 5.6 and appendix F (grid mappings), 6.1 (labels)."""
    found = opened(export_map(straight, "netcdf") if wanted == "map" else export(straight, "netcdf").content)
    assert all(found.attrs[name] for name in ("Conventions", "title", "source", "history"))
    for name, variable in found.variables.items():
        assert "grid_mapping" not in variable.attrs
        assert "grid_mapping_name" not in variable.attrs  # there is none for a fisheye
        assert variable.attrs["long_name"] or name == "camera"
        named = {key: variable.attrs.get(key, variable.encoding.get(key, "")) for key in ("ancillary_variables",)}
        assert all(other in found.variables for text in named.values() for other in text.split())
        if name in found.sizes:  # a coordinate variable: numeric and rising
            assert np.all(np.diff(variable.values) > 0)
        labels = [str(n) for n, v in found.variables.items() if v.dtype.kind in "OU" and v.dims[0] in variable.dims]
        if variable.ndim > 1:
            assert set(variable.encoding.get("coordinates", "").split()) >= set(labels)


def test_the_npz_of_the_map_holds_the_same(straight: dict[str, Any]) -> None:
    found, same = opened(export_map(straight, "netcdf")), np.load(io.BytesIO(export_map(straight, "npz")))
    for name in ("zenith", "azimuth", "direction", "sigma", "x", "y"):
        np.testing.assert_array_equal(same[name], found[name])
    assert json.loads(str(same["attributes"]))["zenith"]["units"] == "degree"


def test_the_grid_of_a_calibration_interpolates_to_the_stated_error(
    document: dict[str, Any], camera: Camera, sky: tuple[FloatArray, FloatArray]
) -> None:
    exported = export(document, "netcdf")
    found = opened(exported.content)
    assert exported.error.removeprefix("between the pixels of the grid, ") in found.attrs["fit_error"]
    assert json.loads(found.attrs["calibration_document"]) == document
    np.testing.assert_array_equal(found["covariance"], document["uncertainty"]["covariance"])
    assert found["parameter_name"].values.tolist() == document["uncertainty"]["parameters"]
    grid = RegularGridInterpolator(
        (found["y"].values, found["x"].values), found["direction"].values, bounds_error=False
    )
    between = grid(sky[1][:, ::-1])
    between /= np.linalg.norm(between, axis=-1, keepdims=True)
    off = np.linalg.norm(project(camera, between) - sky[1], axis=-1)
    assert np.nanmax(off) < 1.1 * worst_stated_px(exported.error) < 0.1
    same = np.load(io.BytesIO(export(document, "npz").content))
    np.testing.assert_array_equal(same["direction"], found["direction"])
