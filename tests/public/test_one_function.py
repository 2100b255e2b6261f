"""A name, its command and its route are one function: ten cameras get the same digits from all three."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tests.fixtures.command_line import sunarc
from tests.fixtures.served import Client, new_archive

import sunarc as names
from sunarc.common.utc import rfc3339, utc_time
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.web.app import create_app
from sunarc.imager.web.options import ApiOptions
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_angles, sun_directions

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

__all__ = ["sunarc"]

SITE = names.Site(latitude=SGP.latitude, longitude=SGP.longitude, altitude_m=SGP.altitude)
PLACE = ("--latitude", str(SGP.latitude), "--longitude", str(SGP.longitude), "--altitude", str(SGP.altitude))
SIZE = (1748, 1748)
X_PX, Y_PX = [400.0, 871.3, 1200.0, 700.5], [880.0, 883.9, 300.0, 1500.25]
ZENITH_DEG, AZIMUTH_DEG = [30.0, 5.0, 71.5, 88.0], [200.0, 10.0, 93.0, 310.0]
NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
PLACES = 10
"""Decimal places that the commands write."""


class Fitted:
    """A camera by the command and by Python, from one file of sightings."""

    def __init__(self, seed: int, folder: Path, sunarc: Sunarc) -> None:
        self.file, self.calibration_file = folder / f"camera{seed}.csv", folder / f"camera{seed}.json"
        mirrored = ("--mirrored", "yes") if seed % 3 == 2 else ()
        write_day(self.file, replace(true_camera(seed), mirrored=bool(mirrored)), seed)
        self.command = sunarc("calibrate", str(self.file), *PLACE, "--image-size", "1748,1748", *mirrored, "--json")
        self.calibration_file.write_text(self.command.out)
        sightings = names.read_sightings(self.file)
        self.python = names.calibrate(sightings, SITE, image_size=SIZE, mirrored="yes" if mirrored else None)


def write_day(path: Path, camera: Camera, seed: int) -> None:
    """Write a clear day of sightings, one every eight minutes, with 0.1 px of noise."""
    unix_s = datetime(2013, 5, 13, 11, tzinfo=UTC).timestamp() + np.arange(0.0, 15 * 3600.0, 480.0)
    unix_s = unix_s[sun_angles(unix_s, SGP).apparent_zenith < 85.0]
    pixels = project(camera, sun_directions(unix_s, SGP)) + np.random.default_rng(seed).normal(0, 0.1, (unix_s.size, 2))
    rows = [
        f"{rfc3339(utc_time(t))},{x:.4f},{y:.4f}" for t, (x, y) in zip(unix_s.tolist(), pixels.tolist(), strict=True)
    ]
    path.write_text("\n".join(["time_utc,x_px,y_px", *rows, ""]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cameras")


@pytest.fixture(params=range(10))
def fitted(request: pytest.FixtureRequest, folder: Path, sunarc: Sunarc) -> Fitted:
    return Fitted(request.param, folder, sunarc)


@pytest.fixture
def client(tmp_path: Path) -> Iterator[tuple[Client, Any]]:
    archive = new_archive(tmp_path / "archive.sqlite")
    board = StatusRegistry(version="0", started_at=NOON, monotonic=lambda: 0.0)
    app = create_app(
        archive=archive,
        camera="roof",
        site=SGP,
        status=board.snapshot,
        request_refit=lambda _: pytest.fail("not asked for"),
        frame_clock=lambda: NOON,
        latest_image=lambda: None,
        options=ApiOptions(allowed_hosts=("imager",)),
    )
    yield Client(app), archive
    archive.close()


def written(values: Any) -> list[str]:  # noqa: ANN401 - numbers
    """Return numbers as a command writes them."""
    return ["" if np.isnan(value) else f"{value:.{PLACES}f}" for value in np.asarray(values, dtype=np.float64).tolist()]


def column(answer: str, name: str) -> list[str]:
    header, *rows = answer.splitlines()
    return [row.split(",")[header.split(",").index(name)] for row in rows]


def plain(values: Any) -> list[Any]:  # noqa: ANN401 - numbers
    return [None if np.isnan(value) else value for value in np.asarray(values, dtype=np.float64).tolist()]


@pytest.mark.slow
def test_command_route_and_name_give_the_same_digits(
    fitted: Fitted, client: tuple[Client, Any], sunarc: Sunarc
) -> None:
    of_command, of_python = json.loads(fitted.command.out), fitted.python.document
    assert {**of_command, "created_at": ""} == {**of_python, "created_at": ""}
    assert fitted.python.verdict in {"accepted", "refused", "marginal"}
    assert (fitted.command.code == 0) == fitted.python.accepted
    asked: dict[str, Any] = {} if fitted.python.accepted else {"accept_refused": True}
    look = fitted.python.back_project(X_PX, Y_PX, **asked)
    seen = fitted.python.project(zenith_deg=ZENITH_DEG, azimuth_deg=AZIMUTH_DEG, **asked)
    named = ("--calibration", str(fitted.calibration_file))
    pixels = "\n".join(["x_px,y_px", *(f"{x},{y}" for x, y in zip(X_PX, Y_PX, strict=True))])
    angles = "\n".join(["zenith_deg,azimuth_deg", *(f"{z},{a}" for z, a in zip(ZENITH_DEG, AZIMUTH_DEG, strict=True))])
    unprojected, projected = sunarc("unproject", *named, stdin=pixels).out, sunarc("project", *named, stdin=angles).out
    for name in ("zenith_deg", "azimuth_deg", "sigma_deg"):
        assert column(unprojected, name) == written(getattr(look, name))
    for name in ("x_px", "y_px", "sigma_px"):
        assert column(projected, name) == written(getattr(seen, name))
    assert column(projected, "cov_xy") == written(seen.covariance_px2[:, 0, 1])

    asking, archive = client
    document = of_python | {"camera": "roof", "pose_epoch": archive.epochs.find("roof")[-1].id}
    archive.calibrations.add(document | {"verdict": document["verdict"] | {"accepted": True}})
    archive.calibrations.activate(document["id"])
    back = asking.post("/v1/back-project", json={"pixels": [list(one) for one in zip(X_PX, Y_PX, strict=True)]}).json()
    for name in ("zenith_deg", "azimuth_deg", "sigma_deg"):
        assert back[name] == plain(getattr(look, name))
    forth = asking.post("/v1/project", json={"zenith_deg": ZENITH_DEG, "azimuth_deg": AZIMUTH_DEG}).json()
    assert [None if one is None else one[0] for one in forth["pixels"]] == plain(seen.x_px)
    assert forth["sigma_px"] == plain(seen.sigma_px)
    question = {"pixels": [[400.0, 880.0], [700.5, 1000.25]], "height_m": 1500.0, "height_sigma_m": 100.0}
    found = asking.post("/v1/geolocate", json=question, params={"at": rfc3339(NOON)}).json()
    cloud = fitted.python.geolocate(
        [400.0, 700.5], [880.0, 1000.25], cloud_height_m=1500.0, cloud_height_sigma_m=100.0, time=NOON, **asked
    )
    for name in ("east_m", "north_m", "latitude", "longitude", "sigma_m"):
        assert found["cloud"][name] == plain(getattr(cloud, name))
        assert cloud.shadow is not None
        assert found["shadow"][name] == plain(getattr(cloud.shadow, name))


@pytest.fixture(scope="module")
def known() -> names.Calibration:
    return names.load(Path(__file__).parents[2] / "docs" / "examples" / "front_door" / "calibration.json")


def test_the_text_of_a_calibration_is_what_the_command_prints(
    known: names.Calibration, sunarc: Sunarc, tmp_path: Path
) -> None:
    write_day(tmp_path / "day.csv", true_camera(0), 0)
    printed = sunarc("calibrate", str(tmp_path / "day.csv"), *PLACE, "--image-size", "1748,1748").out
    found = names.calibrate(names.read_sightings(tmp_path / "day.csv"), SITE, image_size=SIZE)
    assert str(found) + "\n" == printed
    assert str(known).splitlines()[0].split() == ["projection", "equisolid"]


def test_two_cameras_are_compared_as_the_command_compares_them(
    known: names.Calibration, sunarc: Sunarc, tmp_path: Path
) -> None:
    first, second = tmp_path / "calibration.json", tmp_path / "camera.yml"
    known.save(first)
    known.export("opencv", second)
    command = json.loads(sunarc("compare", str(first), str(second), "--json").out)
    found = names.compare(known, second)
    assert (found.total.rms_px, found.total.max_deg) == (command["rms_px"], command["max_deg"])
    assert found.rotation_deg == command["rotation_deg"]


def test_the_sun_is_where_the_route_says(client: tuple[Client, Any]) -> None:
    answer = client[0].get("/v1/sun", params={"at": rfc3339(NOON)}).json()
    sun = names.sun_position(NOON, SITE)
    assert (sun.zenith_deg, sun.true_zenith_deg, sun.azimuth_deg) == (
        answer["apparent_zenith"],
        answer["zenith"],
        answer["azimuth"],
    )


def test_draws_are_those_of_the_route(known: names.Calibration, client: tuple[Client, Any]) -> None:
    asking, archive = client
    document = known.document | {"camera": "roof", "pose_epoch": archive.epochs.find("roof")[-1].id}
    archive.calibrations.add(document)
    archive.calibrations.activate(document["id"])
    question = {"pixels": [[400.0, 880.0]]}
    answer = asking.post("/v1/back-project", json=question, params={"draws": 5, "seed": 3}).json()
    drawn = known.draw(5, seed=3).back_project(400.0, 880.0)
    assert [one[0] for one in answer["draws"]["zenith_deg"]] == drawn.zenith_deg.tolist()


def test_a_picture_s_sun_is_the_command_s(sunarc: Sunarc) -> None:
    picture = Path(__file__).parents[2] / "docs" / "examples" / "front_door" / "pictures" / "20130513T181400Z.jpg"
    (row,) = json.loads(sunarc("detect", str(picture), "--json").out)
    sun = names.find_sun(picture)
    assert (sun.x_px, sun.y_px, sun.sigma_px, sun.accepted) == (
        row["x_px"],
        row["y_px"],
        row["sigma_px"],
        row["accepted"],
    )
