"""Remap tables and rectified composites over HTTP: against the projection itself, and what cannot be given."""

from __future__ import annotations

import io
import json
import math
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.common.errors import InputError
from sunarc.formats.formats import read_view
from sunarc.formats.view import camera_view, compare
from sunarc.imager.archive.images import ImageStore
from sunarc.optics.forward import project
from sunarc.sky.directions import direction_from_angles

if TYPE_CHECKING:
    from tests.fixtures.served import Made, Make

TIME = datetime(2013, 5, 13, 17, 0, 0, 250_000, tzinfo=UTC)
PICTURE = "/v1/images/2013-05-13T17:00:00.250Z/rectified"


def tables(made: Made, **query: object) -> dict[str, NDArray[Any]]:
    answer = made.client.get("/v1/remap", params=query)
    assert answer.status_code == 200, answer.text
    with np.load(io.BytesIO(answer.content)) as file:
        return {name: file[name] for name in file.files}


@pytest.fixture
def served(make: Make, tmp_path: Path) -> Made:
    """Return a service with one preview: brightness is x / 8, in each colour."""
    store = ImageStore(tmp_path / "images", free_bytes=lambda _: 10**12)
    made: Made = make(history="filled", images=store)
    width, height = made.lens.width, made.lens.height
    ramp = np.repeat(np.tile((np.arange(width) / 8.0).astype(np.uint8), (height, 1))[..., None], 3, axis=2)
    encoded = cv2.imencode(".jpg", ramp, [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    store.write(TIME, encoded, kind="hdr.jpg")
    return made


def test_the_sky_grid_shows_each_direction_where_the_camera_has_it(made: Made) -> None:
    size = 201
    found = tables(made, size=size)
    camera = made.archive.calibrations.model("second").camera
    middle = (size - 1) // 2
    for row, column in ((middle, middle), (middle - 50, middle), (middle, middle + 40), (middle + 30, middle - 60)):
        east, north = (middle - column) / (size / 2.0), (middle - row) / (size / 2.0)
        zenith, azimuth = 90.0 * math.hypot(east, north), math.degrees(math.atan2(east, north)) % 360.0
        pixel = project(camera, direction_from_angles(zenith_deg=zenith, azimuth_deg=azimuth))
        np.testing.assert_allclose([found["map_x"][row, column], found["map_y"][row, column]], pixel, atol=1e-3)
    assert found["map_x"].dtype == np.float32
    assert found["map_x"][0, 0] == -1.0
    said = json.loads(str(found["attributes"]))["attributes"]
    assert (said["grid"], said["calibration"]) == ("sky", "second")


def test_the_tables_are_read_as_those_of_the_export(made: Made) -> None:
    camera = made.archive.calibrations.model("second").camera
    answer = made.client.get("/v1/remap", params={"size": min(camera.width, camera.height)})
    found = compare(camera_view(camera), read_view(answer.content, name="remap.npz"))
    assert 0.0 < found.total.max_px < 0.01
    assert found.undescribed < 0.01
    ground = made.client.get("/v1/remap", params={"size": 64, "grid": "ground"})
    with pytest.raises(InputError, check=lambda error: error.field == "remap.npz"):
        read_view(ground.content, name="remap.npz")


def test_the_ground_grid_shows_the_cloud_above_each_place(made: Made) -> None:
    found = tables(made, grid="ground", size=101, height=1500.0, half_width=3000.0)
    camera = made.archive.calibrations.model("second").camera
    east, north = 600.0, -900.0
    column, row = round(50 + east / 60.0), round(50 - north / 60.0)
    zenith = math.degrees(math.atan2(math.hypot(east, north), 1500.0))
    azimuth = math.degrees(math.atan2(east, north)) % 360.0
    pixel = project(camera, direction_from_angles(zenith_deg=zenith, azimuth_deg=azimuth))
    # flat and curved ground differ by 0.05 m in height at 1 km
    np.testing.assert_allclose([found["map_x"][row, column], found["map_y"][row, column]], pixel, atol=0.1)


def test_the_errors_over_the_grid_are_stated(made: Made) -> None:
    query = {"grid": "ground", "size": 64, "height": 1500.0, "half_width": 1500.0}
    low, high = (made.client.get("/v1/remap", params=query | {"height": height}).headers for height in (1500.0, 3000.0))
    sigma, sigma_m = float(low["sunarc-sigma-deg"]), float(low["sunarc-sigma-m"])
    # within 55 degrees of the zenith a small angle moves the cloud by 1 to 3 heights
    assert 1.0 < sigma_m / (1500.0 * math.radians(sigma)) < 3.0
    assert float(high["sunarc-sigma-m"]) > 1.2 * sigma_m
    assert low["sunarc-height-m"] == "1500"
    assert made.client.get("/v1/remap", params={"grid": "ground", "size": 16}).headers["sunarc-height-m"] == "1000"
    assert not {"sunarc-sigma-m", "sunarc-height-m"} & set(made.client.get("/v1/remap").headers)


def test_tables_come_as_netcdf_with_the_same_numbers(made: Made) -> None:
    h5netcdf = pytest.importorskip("h5netcdf")
    answer = made.client.get("/v1/remap", params={"size": 32, "format": "netcdf"})
    with h5netcdf.File(io.BytesIO(answer.content), "r") as file:
        np.testing.assert_array_equal(file.variables["map_y"][...], tables(made, size=32)["map_y"])


def test_netcdf_of_the_ground_has_coordinates_that_pyproj_places(made: Made) -> None:
    xarray, pyproj = pytest.importorskip("xarray"), pytest.importorskip("pyproj")
    query = {"size": 64, "format": "netcdf", "grid": "ground", "height": 1500.0, "half_width": 4000.0}
    with xarray.open_dataset(
        io.BytesIO(made.client.get("/v1/remap", params=query).content), engine="h5netcdf"
    ) as opened:
        ground = opened.load()
    assert (ground.x[0], ground.x[-1], ground.y[0], ground.y[-1]) == (-4000.0, 4000.0, 4000.0, -4000.0)
    crs = pyproj.CRS.from_cf(ground[ground.map_x.attrs["grid_mapping"]].attrs)
    place = pyproj.Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True)
    longitude, latitude = place.transform(ground.x.values[-1], ground.y.values[0])
    site = made.archive.calibrations.model("second").site
    north_m = math.radians(latitude - site.latitude) * 6_371_008.8
    east_m = math.radians(longitude - site.longitude) * 6_371_008.8 * math.cos(math.radians(latitude))
    np.testing.assert_allclose([east_m, north_m], [4000.0, 4000.0], atol=5.0)
    sky = made.client.get("/v1/remap", params={"size": 64, "format": "netcdf"}).content
    with xarray.open_dataset(io.BytesIO(sky), engine="h5netcdf") as of_sky:
        assert (of_sky.map_x.dims, of_sky.x.attrs["units"]) == (("y", "x"), "degree")
        at = of_sky.map_x.sel(x=0.0, y=45.0, method="nearest")  # half way up in the north
        zenith, azimuth = np.hypot(at.x, at.y).item(), math.degrees(math.atan2(at.x, at.y)) % 360.0
        direction = direction_from_angles(zenith_deg=zenith, azimuth_deg=azimuth)
        assert at.item() == pytest.approx(
            project(made.archive.calibrations.model("second").camera, direction)[0], abs=1e-3
        )


def test_who_has_the_tables_gets_304_until_the_grid_or_the_calibration_changes(made: Made) -> None:
    tag = made.client.get("/v1/remap", params={"size": 32}).headers["etag"]
    for query, status in (({"size": 32}, 304), ({"size": 33}, 200), ({"size": 32, "calibration": "first"}, 200)):
        answer = made.client.get("/v1/remap", params=query, headers={"if-none-match": tag})
        assert answer.status_code == status
    assert answer.headers["sunarc-calibration"] == "first"


def test_a_composite_is_rectified_as_by_its_tables(served: Made) -> None:
    answer = served.client.get(PICTURE, params={"size": 200, "calibration": "second"})
    assert (answer.status_code, answer.headers["content-type"]) == (200, "image/png")
    picture = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    map_x = tables(served, size=200)["map_x"]
    seen = map_x >= 0.0
    np.testing.assert_allclose(picture[seen, 1].astype(float), map_x[seen] / 8.0, atol=3.0)
    assert np.all(picture[~seen] == 0)
    again = served.client.get(
        PICTURE, params={"size": 200, "calibration": "second"}, headers={"if-none-match": answer.headers["etag"]}
    )
    assert again.status_code == 304


def test_the_ground_picture_has_its_error_in_metres(served: Made) -> None:
    query = {"grid": "ground", "height": 2000.0, "size": 100, "calibration": "second"}
    answer = served.client.get(PICTURE, params=query)
    assert answer.status_code == 200
    assert float(answer.headers["sunarc-sigma-m"]) > 0.0


@pytest.mark.parametrize(
    ("query", "field"),
    [
        ({"size": 15}, "size"),
        ({"size": 10**10}, "size"),
        ({"grid": "ground", "height": 0.0}, "height"),
        ({"grid": "ground", "height": 1e6}, "height"),
        ({"grid": "ground", "height": 1000.0, "half_width": -1.0}, "half_width"),
        ({"grid": "moon"}, "grid"),
        ({"format": "tiff"}, "format"),
        ({"sice": 64}, "sice"),
    ],
)
def test_a_grid_that_cannot_be_made_is_refused(made: Made, query: dict[str, object], field: str) -> None:
    answer = made.client.get("/v1/remap", params=query)
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == field


def test_a_composite_that_is_not_kept_is_not_found(served: Made) -> None:
    answer = served.client.get("/v1/images/2013-05-13T17:00:01Z/rectified", params={"calibration": "second"})
    assert (answer.status_code, answer.json()["errors"][0]["field"]) == (404, "time")


def test_an_image_of_another_size_is_refused(make: Make, tmp_path: Path) -> None:
    store = ImageStore(tmp_path / "images", free_bytes=lambda _: 10**12)
    store.write(TIME, cv2.imencode(".jpg", np.zeros((60, 80), np.uint8))[1].tobytes(), kind="hdr.jpg")
    answer = make(history="filled", images=store).client.get(PICTURE, params={"calibration": "second"})
    assert (answer.status_code, answer.json()["errors"][0]["field"]) == (422, "time")


def test_tables_of_the_sky_of_former_versions_are_read_as_they_say(made: Made) -> None:
    camera = made.archive.calibrations.model("second").camera
    content = made.client.get("/v1/remap", params={"size": min(camera.width, camera.height)}).content
    with np.load(io.BytesIO(content)) as file:
        former = {name: file[name][:, ::-1] if file[name].ndim == 2 else file[name] for name in file.files}
    former["attributes"] = np.array(str(former["attributes"]).replace("east at the left", "east at the right"))
    target = io.BytesIO()
    np.savez(target, **former)
    found = compare(camera_view(camera), read_view(target.getvalue(), name="remap.npz"))
    assert 0.0 < found.total.max_px < 0.01
