from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.interpolate import RegularGridInterpolator
from tests.formats.conftest import FloatArray, worst_stated_px

from sunarc.calibration.answers.covariance import unproject_with_sigma
from sunarc.formats.calibration_document import from_document
from sunarc.formats.formats import export
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.directions import angles_from_direction


def opened(content: bytes) -> Any:  # noqa: ANN401 - of xarray
    return xr.load_dataset(io.BytesIO(content), engine="h5netcdf")


def test_the_map_opens_in_xarray_and_says_what_single_pixels_say(straight: dict[str, Any]) -> None:
    found = opened(export(straight, "map-netcdf").content)
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
def test_netcdf_keeps_the_rules_of_the_cf_conventions(small: dict[str, Any], wanted: str) -> None:
    """CF 1.11: 2.6.2 (history), 3.4 (ancillary variables), 4 (coordinates), 5.6 (grid mappings), 6.1 (labels), 7.1."""
    content = export(small, "map-netcdf" if wanted == "map" else "netcdf").content
    found = xr.load_dataset(io.BytesIO(content), engine="h5netcdf", decode_cf=False)
    for name, variable in found.variables.items():
        assert "grid_mapping" not in variable.attrs
        assert "grid_mapping_name" not in variable.attrs  # there is none for a fisheye
        assert name == "time_bnds" or variable.attrs["long_name"]
        named = " ".join(variable.attrs.get(key, "") for key in ("ancillary_variables", "coordinates", "bounds"))
        assert all(other in found.variables for other in named.split())
        if name in found.sizes:  # a coordinate variable: numeric and rising
            assert np.all(np.diff(variable.values) > 0)
        labels = {str(n) for n, v in found.variables.items() if v.dtype.kind in "OU" and v.dims[0] in variable.dims}
        if variable.ndim > 1 and name != "time_bnds":
            coordinates = set(variable.attrs["coordinates"].split())
            assert coordinates >= labels
            assert name == "covariance" or coordinates >= {"latitude", "longitude", "altitude"}
    assert [found[name].attrs["units"] for name in ("latitude", "longitude", "altitude")] == [
        "degrees_north", "degrees_east", "m",
    ]  # fmt: skip
    assert (float(found["latitude"]), found["latitude"].ndim) == (36.604043, 0)
    assert found["time_bnds"].shape == (2, 2)
    assert found["zenith"].attrs["standard_name"] == "zenith_angle"


def test_the_time_is_the_validity_and_the_whole_says_who_and_what(straight: dict[str, Any]) -> None:
    """ACDD 1.3, the attributes that it recommends highly, and those that it recommends."""
    ended = straight | {"valid_until": "2014-01-01T00:00:00Z"}
    found = opened(export(ended, "netcdf").content)
    assert found["time"].values.tolist() == found["time_bnds"].values[0].tolist()
    assert [str(time)[:10] for time in found["time"].values] == ["2013-05-13", "2014-01-01"]
    seconds = 233 * 86400
    assert found.attrs["time_coverage_duration"] == f"PT{seconds}S"
    for names in ("title keywords summary Conventions id naming_authority history comment date_created license",
                  "creator_name creator_url creator_email institution project processing_level acknowledgment",
                  "publisher_name publisher_url publisher_email standard_name_vocabulary product_version",
                  "geospatial_bounds geospatial_bounds_crs geospatial_bounds_vertical_crs geospatial_vertical_positive",
                  "time_coverage_start time_coverage_end time_coverage_resolution"):  # fmt: skip
        assert all(found.attrs[name] for name in names.split())
    assert found.attrs["id"] == ended["id"]
    assert json.loads(found.attrs["provenance"]) == {"days": ["2013-05-13"], "n_used": 1440, "n_rejected": 60}
    assert {found.attrs[f"geospatial_lat_{end}"] for end in ("min", "max")} == {36.604043}
    open_ended = opened(export(straight, "netcdf").content)
    assert open_ended.attrs["time_coverage_end"].startswith("2199")


def test_the_npz_of_the_map_holds_the_same(small: dict[str, Any]) -> None:
    found, same = (
        opened(export(small, "map-netcdf").content),
        np.load(io.BytesIO(export(small, "map-npz").content)),
    )
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
