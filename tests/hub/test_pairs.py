"""The height of a point that two cameras of a hub see: against a made truth, and what is refused."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.fixtures.archive import make_empty
from tests.fixtures.served import LENS, NOON, Client, calibration

from sunarc.formats.calibration_document import to_document
from sunarc.geolocation.locate import local_frame
from sunarc.hub.archive import open_hub_archive
from sunarc.hub.serving import create_hub_app
from sunarc.imager.archive.values import CameraRecord
from sunarc.imager.runtime.status import StatusSnapshot
from sunarc.imager.web.options import ApiOptions
from sunarc.optics.forward import project
from sunarc.sky.site import Site

SITES = {
    "a": Site(latitude=36.6, longitude=-97.5, altitude=318.0),
    "b": Site(latitude=36.605, longitude=-97.49, altitude=330.0),
}
CLOUD = Site(latitude=36.61, longitude=-97.52, altitude=2318.0)


def pixel_of(name: str, place: Site = CLOUD) -> list[float]:
    """Return where a camera sees a place."""
    axes, origin = local_frame(SITES[name])
    ray = axes @ (local_frame(place)[1] - origin)
    return [float(number) for number in project(LENS, ray / np.linalg.norm(ray))]


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    folder: Path = tmp_path_factory.mktemp("pairs")
    make_empty(folder / "hub.sqlite")
    with open_hub_archive(folder / "hub.sqlite") as archive:
        for name, site in SITES.items():
            record = CameraRecord(
                name=name, latitude=site.latitude, longitude=site.longitude, width=1748, height=1748, altitude=0.0
            )
            archive.cameras.save(replace(record, altitude=site.altitude))
            epoch = archive.epochs.open(name, at=NOON - timedelta(days=2), reason="installed")
            made = to_document(
                replace(calibration(), site=site),
                id=f"of-{name}",
                camera=name,
                state="candidate",
                created_at=NOON,
                valid_from=NOON - timedelta(days=1),
                valid_until=None,
                pose_epoch=epoch.id,
                software_version="0.1.0",
            )
            archive.calibrations.add(made)
            archive.calibrations.activate(f"of-{name}", at=NOON - timedelta(days=1))
        archive.cameras.save(CameraRecord(name="new", latitude=0.0, longitude=0.0, altitude=0.0, width=8, height=6))
        app = create_hub_app(
            archive=archive,
            status=lambda: StatusSnapshot(version="1", started_at=NOON),
            now=lambda: NOON,
            options=ApiOptions(allowed_hosts=("imager",)),
        )
        yield Client(app)


def asked(**changes: Any) -> dict[str, Any]:  # noqa: ANN401 - JSON
    return {"time": "2013-05-13T18:30:00Z", "pixel_a": pixel_of("a"), "pixel_b": pixel_of("b")} | changes


def test_two_pixels_of_one_place_give_its_height(client: Client) -> None:
    found = client.post("/v1/pairs/a/b/height", json=asked()).json()
    assert (found["calibration_a"], found["calibration_b"]) == ("of-a", "of-b")
    assert abs(found["height_m"] - 2000.0) < 3.0 * found["sigma_m"] < 60.0
    assert (found["latitude"], found["longitude"]) == pytest.approx((36.61, -97.52), abs=2e-4)
    assert abs(found["miss_m"]) < 3.0 * found["miss_sigma_m"]
    # of the same two rays, from the other end
    pixels = {"pixel_a": pixel_of("b"), "pixel_b": pixel_of("a")}
    back = client.post("/v1/pairs/b/a/height", json=asked(**pixels)).json()
    assert back["height_m"] + 330.0 == pytest.approx(found["height_m"] + 318.0, abs=0.5)
    assert back["sigma_m"] == pytest.approx(found["sigma_m"], rel=0.02)


@pytest.mark.parametrize(
    ("path", "changes", "status", "field"),
    [
        ("a/a", {}, 422, "b"),
        ("a/none", {}, 404, "camera"),
        ("a/new", {}, 404, "calibration"),
        ("a/b", {"time": "1999-01-01T00:00:00Z"}, 404, "at"),
        ("a/b", {"time": "noon"}, 422, "time"),
        ("a/b", {"pixel_a": [1e6, 0.0]}, 422, "pixel_a"),
        ("a/b", {"pixel_b": pixel_of("b", replace(CLOUD, altitude=400.0, longitude=-98.1))}, 422, "pixel_b"),
        ("a/b", {"pixel_b": pixel_of("a")}, 422, "pixel_b"),
        ("a/b", {"pixel_c": [1.0, 2.0]}, 422, "pixel_c"),
    ],
)
def test_what_has_no_height_is_a_problem(
    client: Client, path: str, changes: dict[str, Any], status: int, field: str
) -> None:
    answer = client.post(f"/v1/pairs/{path}/height", json=asked(**changes))
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["errors"][0]["field"] == field
