from __future__ import annotations

from datetime import timedelta
from typing import TYPE_CHECKING, Any

from pydantic import TypeAdapter
from tests.fixtures.nights import judged

from sunarc.common.findings import Finding
from sunarc.imager.archive.values import NightBand, NightSeries

if TYPE_CHECKING:
    from tests.fixtures.served import Made

NUMBERS: dict[str, Any] = {
    "n_images": 48, "n_accepted": 46, "n_stored": 1380, "n_stars": 1700, "n_matched": 620, "limiting_magnitude": 5.5,
    "star_fwhm_px": 2.4, "cloud_fraction": 0.1, "transparency": 0.83, "extinction": 0.2, "extinction_sigma": 0.01,
    "zero_point": 10.9, "star_ellipticity": 0.1, "halo": 0.01, "width_growth": 1.02, "halo_growth": 0.0,
    "fading_mag": 0.05, "n_moon_images": 12, "n_moon_stored": 11, "n_warm_pixels": 310, "star_offset_px": 0.12,
}  # fmt: skip


PARTS: dict[str, Any] = {
    "zenith_bands": [{"from_deg": 0.0, "to_deg": 30.0, "predicted": 40, "found": 38, "transparency": 0.8}],
    "images": {
        "time": ["2013-05-13T05:00:02Z"], "n_matched": [620], "cloud_fraction": [0.1], "limiting_magnitude": [5.1],
        "star_fwhm_px": [2.4], "star_ellipticity": [0.1], "halo": [None], "zero_point": [10.9],
    },
}  # fmt: skip
SERIES = TypeAdapter(NightSeries).validate_python(PARTS["images"])


def test_nights_are_listed_the_newest_first_with_what_is_known(made: Made) -> None:
    why = Finding("night_images", {"n": 46, "images": 48, "cloud_fraction": 0.1})
    findings = [why.as_json()]
    parts = {"zenith_bands": (NightBand(**PARTS["zenith_bands"][0]),), "images": SERIES}
    told: list[tuple[int, dict[str, Any]]] = [
        (2, {"verdict": "unusable", "n_images": 2}),
        (1, {"verdict": "clear", **NUMBERS, **parts}),
    ]
    for days, data in told:
        time = made.noon - timedelta(days=days)
        made.archive.nights.save(judged(f"{time.date()}", at=time, findings=(why,), **data))
    newest, oldest = made.client.get("/v1/nights").json()["nights"]
    assert newest == {
        "night": "2013-05-12",
        "verdict": "clear",
        "findings": findings,
        "decided_at": "2013-05-12T18:30:00Z",
        **NUMBERS,
        **PARTS,
        "images": None,
        "picture": False,
    }
    assert made.client.get("/v1/nights?images=true").json()["nights"][0]["images"] == PARTS["images"]
    assert (oldest["zenith_bands"], oldest["images"]) == ([], None)
    text = made.client.get("/metrics").text
    assert "sunarc_night_limiting_magnitude 5.5" in text
    assert "sunarc_night_seconds 1.3683168e+09" in text  # the evening of 2013-05-12
    assert "sunarc_night_fading_mag 0.05" in text
    assert (oldest["night"], oldest["n_images"], oldest["limiting_magnitude"]) == ("2013-05-11", 2, None)
    first = made.client.get("/v1/nights", params={"limit": 1}).json()
    assert [night["night"] for night in first["nights"]] == ["2013-05-12"]
    assert first["next"] is not None


def test_without_nights_the_list_is_empty(empty: Made) -> None:
    assert empty.client.get("/v1/nights").json() == {"nights": [], "pose": None, "next": None}


def test_a_night_that_was_judged_again_is_listed_once(made: Made) -> None:
    for verdict, n_images in (("partly", 40), ("clear", 48)):
        made.archive.nights.save(judged("2013-05-12", at=made.noon, verdict=verdict, n_images=n_images))
    page = made.client.get("/v1/nights", params={"limit": 1}).json()
    assert [(night["verdict"], night["n_images"]) for night in page["nights"]] == [("clear", 48)]
    assert page["next"] is None
    assert "sunarc_night_n_images 48.0" in made.client.get("/metrics").text


def test_the_turn_between_day_and_night_is_that_of_the_served_calibration(made: Made) -> None:
    served = made.archive.calibrations.current("roof")
    assert served is not None
    assert made.client.get("/v1/nights").json()["pose"] is None
    night = {
        "n": 150, "pose_difference_deg": [0.004, -0.011, 0.002], "pose_sigma_deg": [0.002, 0.002, 0.003],
        "star_offset_px": 0.1, "star_offset_sigma_px": 0.02,
    }  # fmt: skip
    made.archive.calibrations.add({**served.document, "id": "of-nights", "state": "candidate", "night": night})
    made.archive.calibrations.activate("of-nights")
    assert made.client.get("/v1/nights").json()["pose"] == {
        "calibration": "of-nights", "n": 150, "pose_difference_deg": [0.004, -0.011, 0.002],
        "pose_sigma_deg": [0.002, 0.002, 0.003],
    }  # fmt: skip
