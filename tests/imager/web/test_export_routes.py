from __future__ import annotations

import io
import re
import zipfile
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
import scipy.io
import xarray as xr

from sunarc.imager.web.routes.calibrations import decimal
from sunarc.sky.directions import angular_distance
from sunarc.sky.sun import sun_directions

if TYPE_CHECKING:
    import httpx
    from tests.fixtures.served import Made, Make

FORMATS = {
    "json": "application/json",
    "opencv": "application/yaml",
    "ocamcalib": "text/plain",
    "asi-core": "application/zip",
    "mrcal": "text/plain",
    "netcdf": "application/x-netcdf",
    "npz": "application/x-npz",
}


def ask(made: Made, path: str, **how: Any) -> httpx.Response:  # noqa: ANN401 - of httpx
    answer = made.client.get(path, **how)
    assert answer.status_code in {200, 304}, answer.text
    return answer


def opened(answer: httpx.Response) -> Any:  # noqa: ANN401 - of xarray
    return xr.load_dataset(io.BytesIO(answer.content), engine="h5netcdf")


def camera_file(made: Made, at: dict[str, str]) -> str:
    """Return the YAML of the zip that asi_core's set is sent as; its mask is in it."""
    answer = ask(made, "/v1/calibration", params={"format": "asi-core"} | at)
    with zipfile.ZipFile(io.BytesIO(answer.content)) as found:
        names = sorted(name.rpartition("_")[2].rpartition(".")[2] for name in found.namelist())
        assert names == ["mat", "png", "yaml"]
        return found.read(next(name for name in found.namelist() if name.endswith(".yaml"))).decode()


def mask_in(answer: httpx.Response) -> np.ndarray:
    """Return the mask of asi_core's set, the MATLAB file's, which the PNG agrees with."""
    with zipfile.ZipFile(io.BytesIO(answer.content)) as found:
        files = {name.rpartition(".")[2]: found.read(name) for name in found.namelist()}
    read = scipy.io.loadmat(io.BytesIO(files["mat"]))  # type: ignore[arg-type]
    mask = np.asarray(read["Mask"][0][0][0])
    png = np.asarray(cv2.imdecode(np.frombuffer(files["png"], np.uint8), cv2.IMREAD_GRAYSCALE))
    np.testing.assert_array_equal(png, 255 * mask)
    return mask


@pytest.mark.parametrize("wanted", FORMATS)
def test_every_format_has_its_media_type_its_tag_and_its_error(made: Made, wanted: str) -> None:
    answer = ask(made, "/v1/calibration", params={"format": wanted})
    assert answer.headers["content-type"].partition(";")[0] == FORMATS[wanted]
    tag = answer.headers["etag"]
    known = ask(made, "/v1/calibration", params={"format": wanted}, headers={"if-none-match": tag})
    assert (known.status_code, known.content) == (304, b"")
    if wanted != "json":
        assert tag != ask(made, "/v1/calibration").headers["etag"]
        rms_px, max_px, rms_deg = (answer.headers[f"sunarc-fit-error{part}"] for part in ("", "-max", "-deg"))
        assert all(re.fullmatch(r"\d+(\.\d+)?", number) for number in (rms_px, max_px, rms_deg))
        assert 0.0 < float(rms_px) < float(max_px) < 2.0
        assert 0.03 < float(rms_deg) / float(rms_px) < 3.0  # a pixel has 0.1 degrees, and more near the horizon
        assert "filename=" in answer.headers["content-disposition"]


def test_an_unknown_format_is_refused_by_name(made: Made) -> None:
    for path in ("/v1/calibration", "/v1/back-projection-map"):
        answer = made.client.get(path, params={"format": "matlab"})
        assert answer.status_code == 422
        assert answer.json()["errors"][0]["field"] == "format"


def test_an_export_follows_the_calibration_of_its_time(made: Made) -> None:
    now, before = (camera_file(made, at) for at in ({}, {"at": "2013-05-10T00:00:00Z"}))
    assert ("calibration second" in now, "calibration first" in before) == (True, True)
    assert "demounted: !!timestamp '2013-05-12T18:30:00Z'" in before


def test_the_map_says_what_back_projection_says(make: Make) -> None:
    made = make(history="small")
    answer = ask(made, "/v1/back-projection-map")
    assert answer.headers["content-type"] == "application/x-netcdf"
    found = opened(answer)
    pixels = np.random.default_rng(0).integers(0, 116, (500, 2))
    told = made.client.post("/v1/back-project", json={"pixels": pixels.astype(float).tolist()}).json()
    at = found.isel(x=xr.DataArray(pixels[:, 0]), y=xr.DataArray(pixels[:, 1]))
    for mine, theirs in (("zenith", "zenith_deg"), ("azimuth", "azimuth_deg"), ("sigma", "sigma_deg")):
        np.testing.assert_allclose(at[mine], np.array(told[theirs], dtype=float), atol=1e-4)
    assert (found.attrs["calibration"], "sun_mask" in found, "obstruction_mask" in found) == ("second", False, False)
    known = ask(made, "/v1/back-projection-map", headers={"if-none-match": answer.headers["etag"]})
    assert (known.status_code, known.content) == (304, b"")
    assert ask(made, "/v1/back-projection-map").content == answer.content


def test_a_map_with_the_sun_and_what_hides_the_sky(make: Make, tmp_path: Path) -> None:
    image = np.full((116, 120), 255, dtype=np.uint8)
    image[10:20, 30:50] = 0
    cv2.imwrite(str(tmp_path / "mask.png"), image)
    made = make(history="small", obstruction_mask=tmp_path / "mask.png")
    moment = made.noon + timedelta(hours=2)
    found = opened(ask(made, "/v1/back-projection-map", params={"at": moment.isoformat(), "sun_radius_deg": 12.0}))
    apart = np.degrees(angular_distance(found["direction"].values, sun_directions(moment.timestamp(), made.site)))
    clear = np.abs(apart - 12.0) > 0.01
    np.testing.assert_array_equal(found["sun_mask"].values[clear] == 1, (apart < 12.0)[clear])
    assert found["sun_mask"].attrs["radius_deg"] == 12.0
    assert int(found["obstruction_mask"].sum()) == 10 * 20
    assert int(found["obstruction_mask"][15, 40]) == 1
    masked, whole = (
        ask(one, "/v1/calibration", params={"format": "asi-core"}) for one in (made, make(history="small"))
    )
    assert masked.headers["etag"] != whole.headers["etag"]
    first, second = (mask_in(answer) for answer in (masked, whole))
    np.testing.assert_array_equal(first, np.where(image == 0, 0, second))
    assert np.any(second[image == 0])


def test_a_mask_of_another_size_is_a_problem_that_names_it(make: Make, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "mask.png"), np.zeros((10, 10), dtype=np.uint8))
    answer = make(history="filled", obstruction_mask=tmp_path / "mask.png").client.get("/v1/back-projection-map")
    assert answer.status_code == 503
    assert "1748x1748" in answer.json()["detail"]


def test_the_npz_map_opens_in_numpy(made: Made) -> None:
    content = ask(made, "/v1/back-projection-map", params={"format": "npz"}).content
    assert 45e6 < len(content) < 58e6  # of 73 MB
    found = np.load(io.BytesIO(content))
    assert found["zenith"].shape == (1748, 1748)
    assert found["direction"].dtype == np.float32


@pytest.mark.parametrize(("path", "status"), [("/v1/calibration?format=opencv", 404), ("/v1/back-projection-map", 503)])
def test_without_a_calibration_there_is_nothing_to_export(empty: Made, path: str, status: int) -> None:
    assert empty.client.get(path).status_code == status


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (1500.0, "1500"), (1.23456e-6, "0.000001235"), (12_345_678.0, "12350000"), (0.009876, "0.009876")],
)
def test_numbers_in_headers_are_decimals(value: float, text: str) -> None:
    assert decimal(value) == text
