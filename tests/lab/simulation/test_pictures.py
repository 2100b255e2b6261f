"""A simulated camera that gives its present picture by HTTP, asked by the service that follows its clock."""

from __future__ import annotations

import io
import socket
import threading
from base64 import b64encode
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from email.utils import parsedate_to_datetime
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.fixtures.command_line import Sunarc, sunarc
from tests.fixtures.ports import free_port
from tests.fixtures.settings import new_settings

from sunarc.common.errors import OutsideError
from sunarc.imager.app.service import Service
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.lab.simulation.pictures import PATHS, PictureOptions, PictureServer, PresentPicture, serve_pictures
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_angles, sun_directions

NOON = datetime(2013, 5, 13, 18, 0, tzinfo=UTC)
__all__ = ["sunarc"]
LOGIN = ("viewer", "of:the sky")
DIGEST = 'Digest username="viewer", realm="camera", nonce="n", uri="/record/current.jpg", response=""'


def server(clock: VirtualClock, *, login: tuple[str, str] | None = None, **options: object) -> PictureServer:
    chosen = {"start": NOON, "speed": 240.0, "size": 240, "cloudy_share": 0.0, **options}
    return PictureServer(PresentPicture(PictureOptions(**chosen), clock), login=login)  # type: ignore[arg-type]


def test_the_picture_shows_the_sun_of_the_second_that_its_headers_state() -> None:
    clock = VirtualClock(datetime(2026, 1, 1, tzinfo=UTC))
    camera = server(clock)
    for waited_s, path in ((0.0, PATHS[0]), (7.503, PATHS[1] + "?resolution=240x240")):
        clock.advance(waited_s)
        status, headers, picture = camera.answer(path, None)
        stated = dict(headers)
        time = parsedate_to_datetime(stated["Last-Modified"])
        assert (status, stated["Date"], stated["Content-Type"]) == (200, stated["Last-Modified"], "image/jpeg")
        assert time == (NOON + timedelta(seconds=240.0 * waited_s)).replace(microsecond=0)
        rows, columns = np.nonzero(np.asarray(Image.open(io.BytesIO(picture)).convert("L")) > 250)
        options, true = camera.present.options, camera.present.camera
        (sun,) = project(true, sun_directions([time.timestamp()], options.site))
        assert (columns.mean(), rows.mean()) == pytest.approx(tuple(sun), abs=1.0)
    assert camera.answer(PATHS[0], None)[2] == picture
    assert camera.answer("/", None)[0] == 404


def test_the_nights_are_skipped_and_the_time_never_goes_back() -> None:
    clock = VirtualClock(NOON)
    camera = server(clock, speed=3600.0, size=60)
    times = []
    for _ in range(40):
        times.append(camera.present.now()[0])
        clock.advance(1.0)
    assert times == sorted(times)
    assert {time.date().day for time in times} >= {13, 14, 15}
    zenith = np.asarray(sun_angles([time.timestamp() for time in times], camera.present.options.site).apparent_zenith)
    assert zenith.max() < 88.2


@pytest.mark.parametrize(
    ("authorization", "status"),
    [
        (None, 401),
        ("Basic " + b64encode(b"viewer:of:the sky").decode(), 200),
        ("Basic " + b64encode(b"viewer:another").decode(), 401),
        ("Basic ?", 401),
        (DIGEST, 401),
        ("Digest nothing, uri", 401),
        ("Bearer viewer", 401),
    ],
)
def test_who_has_no_login_gets_a_challenge(authorization: str | None, status: int) -> None:
    found, headers, body = server(VirtualClock(NOON), login=LOGIN).answer(PATHS[0], authorization)
    assert found == status
    assert (body == b"") == (status == 401)
    if status == 401:
        assert [value.partition(" ")[0] for name, value in headers if name == "WWW-Authenticate"] == ["Digest", "Basic"]


@contextmanager
def answering(camera: PictureServer) -> Iterator[str]:
    stop, port = threading.Event(), free_port()
    thread = threading.Thread(target=serve_pictures, args=(camera, ("127.0.0.1", port), stop))
    thread.start()
    try:
        for _ in range(500):
            with suppress(OSError), socket.create_connection(("127.0.0.1", port), 0.1):
                break
            thread.join(0.02)
        yield f"127.0.0.1:{port}"
    finally:
        stop.set()
        thread.join(10.0)


@contextmanager
def asking(base: Path, address: str, password: str) -> Iterator[Service]:
    (base / "login").write_text(f"{LOGIN[0]}:{password}\n")
    http = {"url": f"http://{address}{PATHS[0]}", "token_file": base / "login"}
    settings = new_settings(base, source="http", http=http, capture={"speed": 240.0})
    upgrade(settings.database)
    clock = VirtualClock(datetime(2026, 1, 1, tzinfo=UTC))
    archive = open_archive(settings.archive)
    yield Service(settings, archive=archive, clock=clock, open_camera=lambda: pytest.fail("no camera is opened"))
    archive.close()


def test_the_service_follows_the_clock_of_a_simulated_camera_by_digest(tmp_path: Path) -> None:
    clock = VirtualClock(NOON)
    camera = server(clock, login=LOGIN, size=480)
    with answering(camera) as address, asking(tmp_path, address, LOGIN[1]) as service:
        assert service.snapshots is not None
        assert not service.frame_time.is_known
        for _ in range(2):
            service.snapshots.take()
            clock.advance(0.5)
        points = service.archive.sightings.find("roof")
        snapshot = service.board.snapshot()
    assert [point.time for point in points] == [NOON, NOON + timedelta(seconds=120)]
    assert {point.verdict for point in points} == {"clear"}
    for point in points:
        (sun,) = project(camera.present.camera, sun_directions([point.time.timestamp()], camera.present.options.site))
        assert (point.x_px, point.y_px) == pytest.approx(tuple(sun), abs=2.5)
    assert service.frame_time.now() == points[-1].time
    assert snapshot.reasons == ()
    assert snapshot.last_sighting_at == points[-1].time


def test_a_wrong_password_gives_no_picture(tmp_path: Path) -> None:
    with answering(server(VirtualClock(NOON), login=LOGIN)) as address, asking(tmp_path, address, "other") as service:
        assert service.snapshots is not None
        service.snapshots.take()
        assert {reason.code for reason in service.board.snapshot().reasons} == {"http_denied"}


def test_an_address_that_is_taken_or_none_is_said(sunarc: Sunarc) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(OutsideError):
        serve_pictures(server(VirtualClock(NOON)), taken.getsockname(), threading.Event())
    for text in ("127.0.0.1", "8090", "127.0.0.1:0", "127.0.0.1:99999", ":8090"):
        assert sunarc("simulate", "--http", text).code == 2
    assert sunarc("simulate", "--http", "127.0.0.1:8090", "--folder", "pictures").code == 2
