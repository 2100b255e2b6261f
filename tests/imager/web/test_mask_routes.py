"""Masks over HTTP, pixel by pixel against back-projection."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.optics.inverse import unproject
from sunarc.sky.sun import sun_directions

if TYPE_CHECKING:
    from tests.fixtures.served import Made, Make


def mask(made: Made, path: str, **query: object) -> NDArray[Any]:
    answer = made.client.get(path, params=query)
    assert (answer.status_code, answer.headers["content-type"]) == (200, "image/png"), answer.text
    image = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert set(np.unique(image)) <= {0, 255}
    return np.asarray(np.asarray(image) == 255)


def some_pixels(made: Made) -> NDArray[np.float64]:
    rng = np.random.default_rng(1)
    return np.floor(rng.uniform(0.0, [made.lens.width, made.lens.height], (3000, 2)))


@pytest.mark.parametrize("radius_deg", [5.0, 30.0])
def test_the_sun_s_mask_holds_within_the_radius_of_the_sun(made: Made, radius_deg: float) -> None:
    found = mask(made, "/v1/masks/sun", radius_deg=radius_deg)
    camera = made.archive.calibrations.model("second").camera
    assert found.shape == (camera.height, camera.width)
    pixels = some_pixels(made)
    cosine = unproject(camera, pixels) @ sun_directions(made.noon.timestamp(), made.site)
    x, y = pixels.astype(int).T
    clear = np.abs(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))) - radius_deg) > 0.05
    expected = np.nan_to_num(cosine, nan=-2.0) >= np.cos(np.radians(radius_deg))
    np.testing.assert_array_equal(found[y, x][clear], expected[clear])
    assert 0.0 < found.mean() < 0.5


@pytest.mark.parametrize("elevation_deg", [0.0, 20.0])
def test_the_horizon_s_mask_holds_above_the_elevation(made: Made, elevation_deg: float) -> None:
    found = mask(made, "/v1/masks/horizon", elevation_deg=elevation_deg)
    pixels = some_pixels(made)
    up = unproject(made.archive.calibrations.model("second").camera, pixels)[:, 2]
    x, y = pixels.astype(int).T
    clear = ~(np.abs(np.degrees(np.arcsin(np.clip(up, -1.0, 1.0))) - elevation_deg) < 0.05)
    expected = np.nan_to_num(up, nan=-2.0) >= np.sin(np.radians(elevation_deg))
    np.testing.assert_array_equal(found[y, x][clear], expected[clear])


def test_what_the_obstruction_mask_hides_is_no_sky(make: Make, tmp_path: Path) -> None:
    path = tmp_path / "hidden.png"
    plain: Made = make(history="filled")
    free = np.full((plain.lens.height, plain.lens.width), 255, np.uint8)
    free[:, :700] = 0
    cv2.imwrite(str(path), free)
    found = mask(make(history="filled", obstruction_mask=path), "/v1/masks/horizon")
    whole = mask(plain, "/v1/masks/horizon")
    assert whole[:, :700].any()
    assert not found[:, :700].any()
    np.testing.assert_array_equal(found[:, 700:], whole[:, 700:])


def test_at_another_time_the_sun_is_elsewhere_and_the_horizon_is_not(made: Made) -> None:
    later = {"at": "2013-05-13T21:00:00Z", "calibration": "second"}
    tag = {name: made.client.get(f"/v1/masks/{name}").headers["etag"] for name in ("sun", "horizon")}
    for name, status in (("sun", 200), ("horizon", 304)):
        answer = made.client.get(f"/v1/masks/{name}", params=later, headers={"if-none-match": tag[name]})
        assert answer.status_code == status
    assert not mask(made, "/v1/masks/sun", at="2013-05-13T06:30:00Z", calibration="second").any()  # at night


@pytest.mark.parametrize(
    ("path", "query", "status", "field"),
    [
        ("sun", {"radius_deg": 0.0}, 422, "radius_deg"),
        ("sun", {"radius_deg": 91.0}, 422, "radius_deg"),
        ("sun", {"elevation_deg": 5.0}, 422, "elevation_deg"),
        ("horizon", {"elevation_deg": 90.0}, 422, "elevation_deg"),
        ("horizon", {"calibration": "nothing"}, 404, "calibration"),
    ],
)
def test_a_mask_that_cannot_be_made_is_refused(
    made: Made, path: str, query: dict[str, object], *, status: int, field: str
) -> None:
    answer = made.client.get(f"/v1/masks/{path}", params=query)
    assert (answer.status_code, answer.json()["errors"][0]["field"]) == (status, field)
