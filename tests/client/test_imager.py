from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import numpy as np
import pytest
import uvicorn
from tests.fixtures.calibrations import SITE
from tests.fixtures.served import NOON, fill, new_archive

from sunarc.calibration.answers.covariance import project_with_covariance, unproject_with_sigma
from sunarc.client import Imager, ImagerError
from sunarc.formats.calibration_document import from_document
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.images import ImageStore
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import StatusRegistry, condition, make_condition
from sunarc.imager.web.app import create_app
from sunarc.imager.web.options import ApiOptions

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def board() -> StatusRegistry:
    return StatusRegistry(version="0.1.0", started_at=NOON, monotonic=VirtualClock(NOON).monotonic)


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory, board: StatusRegistry) -> Iterator[str]:
    path = tmp_path_factory.mktemp("served") / "archive.sqlite"
    new_archive(path).close()
    archive = open_archive(path)
    fill(archive)
    images = ImageStore(path.parent / "images", free_bytes=lambda _: 10**12)
    for minutes in range(3):
        images.write(NOON - timedelta(minutes=minutes), b"\x89PNG of minute %d" % minutes, kind="hdr.png")
    app = create_app(
        archive=archive,
        camera="roof",
        site=SITE,
        status=board.snapshot,
        request_refit=archive.refits.get,
        frame_clock=lambda: NOON,
        latest_image=lambda: None,
        options=ApiOptions(),
        images=images,
    )
    listening = socket.create_server(("127.0.0.1", 0))
    server = uvicorn.Server(uvicorn.Config(app, log_level="error", access_log=False))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
    thread.start()
    yield f"http://127.0.0.1:{listening.getsockname()[1]}"
    server.should_exit = True
    thread.join()
    listening.close()
    archive.close()


@pytest.fixture
def imager(address: str) -> Imager:
    return Imager(address)


def test_numpy_goes_in_and_comes_out_in_its_own_shape(imager: Imager) -> None:
    calibration = from_document(imager.calibration())
    pixels = np.random.default_rng(0).uniform(0.0, 1747.0, (20, 30, 2))
    told = imager.back_project(pixels)
    directions, sigma, inside = unproject_with_sigma(calibration, pixels)
    assert (told.zenith_deg.shape, told.calibration) == ((20, 30), "second")
    np.testing.assert_allclose(told.direction, directions, atol=1e-9)
    np.testing.assert_allclose(told.sigma_deg, sigma, rtol=1e-3)
    np.testing.assert_array_equal(told.inside, inside)
    back = imager.project(told.direction)
    np.testing.assert_allclose(back.pixels[inside], pixels[inside], atol=1e-6)
    covariance = project_with_covariance(calibration, directions)[1]
    np.testing.assert_allclose(back.covariance_px2[inside], covariance[inside], atol=1e-5)
    assert imager.back_project([871.0, 700.0]).zenith_deg.shape == ()
    assert imager.back_project([871.0, 700.0], at=datetime(2013, 5, 10, tzinfo=UTC)).calibration == "first"


def test_clouds_and_shadows_are_where_the_geometry_puts_them(imager: Imager) -> None:
    overhead = imager.project([0.0, 0.0, 1.0]).pixels
    cloud, shadow = imager.geolocate(np.array([overhead, [640.0, 760.0]]), height_m=[1000.0, 2000.0])
    np.testing.assert_allclose(cloud.position_m[0], [0.0, 0.0, 1000.0], atol=0.01)
    np.testing.assert_allclose(cloud.altitude, np.array([1318.0, 2318.0]), atol=0.01)
    sun = imager.sun()
    away = np.radians(sun["azimuth"] + 180.0)
    length = 1000.0 * np.tan(np.radians(sun["apparent_zenith"]))
    np.testing.assert_allclose(shadow.position_m[0, :2], [length * np.sin(away), length * np.cos(away)], atol=0.5)
    # overhead, a doubt of an angle moves the cloud by its height times the angle
    sigma = imager.back_project(overhead).sigma_deg
    assert float(cloud.sigma_m[0]) == pytest.approx(1000.0 * np.radians(float(sigma)), rel=0.02)
    night = imager.geolocate(overhead, height_m=1000.0, at=NOON + timedelta(hours=12))[1]
    assert np.all(np.isnan(night.position_m))
    below, _ = imager.geolocate([[5.0, 5.0], [overhead[0], overhead[1]]], height_m=[1000.0, -1.0])
    assert np.all(np.isnan(below.latitude))


def test_points_of_different_times_are_as_if_asked_alone(imager: Imager) -> None:
    pixels, times = np.array([[[640.0, 760.0], [900.0, 500.0]]]), [NOON - timedelta(days=3), NOON - timedelta(hours=3)]
    clouds, shadows = imager.geolocate(pixels, height_m=1500.0, height_sigma_m=40.0, at=times)
    assert clouds.latitude.shape == (1, 2)
    for k, time in enumerate(times):
        alone = imager.geolocate(pixels[0, k], height_m=1500.0, height_sigma_m=40.0, at=time)
        for many, one in zip((clouds, shadows), alone, strict=True):
            np.testing.assert_allclose(many.position_m[0, k], one.position_m, atol=1e-5)
            np.testing.assert_allclose(many.sigma_m[0, k], one.sigma_m, rtol=1e-6)
    with pytest.raises(ValueError, match="time zone"):
        imager.geolocate(pixels, height_m=1500.0, at=[NOON.replace(tzinfo=None)])


def test_draws_come_with_their_axis_before_the_shape_of_the_question(imager: Imager) -> None:
    pixels = np.array([[[700.0, 760.0], [900.0, 500.0]], [[650.0, 700.0], [800.0, 810.0]]])
    estimated = imager.back_project(pixels)
    drawn = imager.back_project_draws(pixels, draws=32, seed=5)
    assert drawn.shape == (32, 2, 2, 3)
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=-1), 1.0)
    spread = np.degrees(np.sqrt(0.5 * np.sum(np.var(drawn, axis=0), axis=-1)))
    assert np.all((spread / estimated.sigma_deg > 0.5) & (spread / estimated.sigma_deg < 1.7))
    again = imager.project_draws(drawn[3], draws=32, seed=5)
    assert again.shape == (32, 2, 2, 2)
    np.testing.assert_allclose(again[3], pixels, atol=1e-3)
    clouds, shadows = imager.geolocate_draws(pixels, height_m=1500.0, height_sigma_m=100.0, draws=32, seed=5)
    assert clouds.shape == shadows.shape == (32, 2, 2, 3)
    located = imager.geolocate(pixels, height_m=1500.0, height_sigma_m=100.0)[0]
    wide = np.sqrt(0.5 * np.sum(np.var(clouds[..., :2], axis=0), axis=-1))
    assert np.all((wide / located.sigma_m > 0.5) & (wide / located.sigma_m < 1.7))


def test_images_are_listed_over_pages_and_come_as_files(imager: Imager, monkeypatch: pytest.MonkeyPatch) -> None:
    found = list(imager.images())
    assert [one["bytes"] for one in found] == [len(b"\x89PNG of minute 0")] * 3
    assert imager.image(found[1]["time"]) == b"\x89PNG of minute 1"
    assert imager.image(NOON - timedelta(minutes=2)) == b"\x89PNG of minute 2"
    assert len(list(imager.images(since=NOON - timedelta(minutes=1), until=NOON))) == 1
    with pytest.raises(ImagerError) as caught:
        imager.image("2013-01-01T00:00:00Z")
    assert caught.value.status == 404
    asked: list[str] = []
    ask = imager._transport.ask

    def in_pages_of_two(path: str, query: dict[str, str | None]) -> object:
        asked.append(path)
        return ask(path, {**query, "limit": "2"})

    monkeypatch.setattr(imager._transport, "ask", in_pages_of_two)
    assert list(imager.images()) == found
    assert asked == ["/v1/images"] * 2


def test_the_map_and_the_exports_come_as_they_are(imager: Imager) -> None:
    found = imager.map(sun_radius_deg=5.0)
    told = imager.back_project([[400.0, 900.0]])
    assert found["zenith"].shape == (1748, 1748)
    assert float(found["zenith"][900, 400]) == pytest.approx(float(told.zenith_deg[0]), abs=1e-4)
    assert 100 < int(found["sun_mask"].sum()) < 20_000
    assert imager.export("ocamcalib").startswith(b"#polynomial coefficients for the DIRECT mapping")


def test_conditions_come_with_code_severity_and_data(imager: Imager, board: StatusRegistry) -> None:
    assert imager.conditions() == ()
    low = condition("disk_low", folder="/var", free_mb=812.0, lacking_mb=388.0, images_mb=90_000.0)
    board.set_condition("disk_low", low)
    board.set_condition("worker_stuck_web", make_condition("worker_stuck", "web", severity="not_ready", limit_s=60.0))
    first, second = imager.conditions()
    assert first == (
        "disk_low",
        "degraded",
        {"folder": "/var", "free_mb": 812.0, "lacking_mb": 388.0, "images_mb": 9e4},
        low.text,
        low.remedy,
        board.snapshot().reasons[0].since,
    )
    assert first[5] is not None
    assert (second.code, second.severity, second.data) == (
        "worker_stuck_web",
        "not_ready",
        {"name": "web", "limit_s": 60.0},
    )
    board.set_condition("disk_low", None)
    board.set_condition("worker_stuck_web", None)


@pytest.mark.parametrize("content", [b"[]", b'{"findings": []}', b'{"reasons": [{"code": "disk_low"}]}', b"no JSON"])
def test_a_status_of_another_kind_is_refused(monkeypatch: pytest.MonkeyPatch, content: bytes) -> None:
    other = Imager("http://127.0.0.1:9")
    monkeypatch.setattr(other._transport, "ask", lambda *_: (content, {}))
    with pytest.raises(ImagerError, check=lambda error: error.status == 200):
        other.conditions()


def test_conditions_of_version_0_2_have_no_data(monkeypatch: pytest.MonkeyPatch) -> None:
    reason = {"code": "disk_low", "severity": "degraded", "text": "little room", "remedy": "free some"}
    other = Imager("http://127.0.0.1:9")
    monkeypatch.setattr(other._transport, "ask", lambda *_: (json.dumps({"reasons": [reason]}).encode(), {}))
    assert other.conditions() == (("disk_low", "degraded", {}, "little room", "free some", None),)


def test_a_verdict_comes_as_codes_with_data(imager: Imager) -> None:
    verdict = imager.calibration()["verdict"]
    assert [finding.code for finding in imager.verdict()] == [finding["code"] for finding in verdict["findings"]]
    assert [finding.text for finding in imager.verdict()] == verdict["reasons"]


@pytest.mark.parametrize(
    ("verdict", "expected"),
    [
        ({"reasons": ["good"]}, [("uncoded", {"text": "good"}, "good")]),  # of version 0.2
        ({"reasons": ["good"], "findings": [{"code": "c", "data": {"n": 1}}]}, [("c", {"n": 1}, "good")]),
        ({"findings": []}, None),
        ({"reasons": ["good"], "findings": []}, None),
        ("none", None),
    ],
)
def test_verdicts_of_other_versions_are_read_or_refused(
    monkeypatch: pytest.MonkeyPatch, verdict: object, expected: list[object] | None
) -> None:
    other = Imager("http://127.0.0.1:9")
    monkeypatch.setattr(other, "calibration", lambda **_: {"verdict": verdict})
    if expected is None:
        with pytest.raises(ImagerError, check=lambda error: error.status == 200):
            other.verdict()
    else:
        assert list(other.verdict()) == expected


def test_a_refusal_carries_the_problem_document(imager: Imager, address: str) -> None:
    with pytest.raises(ImagerError) as refused:
        imager.export("matlab")
    assert refused.value.status == 422
    assert refused.value.problem["errors"][0]["field"] == "format"
    with pytest.raises(ImagerError, match="no camera"):
        Imager(address, camera="elsewhere").sun()
    with pytest.raises(ValueError, match="last dimension"):
        imager.back_project(np.zeros((3, 3)))
    with pytest.raises(ValueError, match="2013-05-13"):
        imager.sun(at=datetime(2013, 5, 13))  # noqa: DTZ001 - what is refused


class _Busy(BaseHTTPRequestHandler):
    asked = 0

    def do_GET(self) -> None:
        type(self).asked += 1
        if self.path.startswith("/v1/cameras") or type(self).asked > 2:
            content, status = b'{"azimuth": 1.0}', 200
        else:
            content, status = b'{"detail": "busy"}', (429, 503)[type(self).asked % 2]
        self.send_response(status)
        self.send_header("Retry-After", "0")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:  # silent
        pass


def test_a_busy_service_is_asked_again_and_an_absent_one_named() -> None:
    with HTTPServer(("127.0.0.1", 0), _Busy) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        address = f"http://127.0.0.1:{server.server_port}"
        assert Imager(address).sun() == {"azimuth": 1.0}
        assert _Busy.asked == 3
        server.shutdown()
        thread.join()
    with pytest.raises(ImagerError) as absent:
        Imager(address, retries=1).sun()
    assert absent.value.status is None


def test_the_client_imports_nothing_else_of_ours() -> None:
    program = "import sys, json, sunarc.client; print(json.dumps([m for m in sys.modules if m.startswith('sunarc')]))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert all(name == "sunarc" or name.startswith("sunarc.client") for name in json.loads(done.stdout))


def test_the_example_draws_the_shadows_way(address: str, tmp_path: Path) -> None:
    target = Path(os.environ.get("SUNARC_EXAMPLE_PNG", tmp_path / "shadow.png"))
    script = ROOT / "docs" / "examples" / "follow_a_shadow.py"
    subprocess.run([sys.executable, script, address, target, "--at", "2013-05-13T18:30:00Z"], check=True)
    assert target.read_bytes().startswith(b"\x89PNG")
