"""A camera that streams by RTSP: its key frames are dated by this host, and each fault has a code."""

from __future__ import annotations

import io
import socket
import threading
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.fixtures.rtsp_camera import RtspCamera
from tests.fixtures.settings import new_settings
from tests.imager.live.followed import never
from tests.imager.live.sky_pictures import Lens, picture, sun_at, with_clock

from sunarc.common.errors import ConfigurationError, InputError
from sunarc.common.findings import Finding
from sunarc.imager.app.service import Service
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.cameras.options import RtspOptions
from sunarc.imager.live import rtsp
from sunarc.imager.live.rtsp import RtspClient
from sunarc.imager.live.snapshots import Snapshot
from sunarc.imager.runtime.clock import ClockState, SystemClock

MORNING = datetime(2025, 5, 13, 15, 0, tzinfo=UTC)
LENS = Lens()
LOGIN = "ow@ner:sec/ret:1"


class MorningClock(SystemClock):
    """The system's clock, set to a morning."""

    def __init__(self) -> None:
        super().__init__()
        self._ahead = MORNING - SystemClock().now()

    def now(self) -> datetime:
        return super().now() + self._ahead

    def advance(self, seconds: float) -> None:
        self._ahead += timedelta(seconds=seconds)

    def state(self) -> ClockState:
        return ClockState(synchronised=True, error_bound_s=0.01)


@pytest.fixture
def camera() -> Iterator[RtspCamera]:
    made = RtspCamera()
    made.image = picture(MORNING, LENS, np.random.default_rng(1))
    yield made
    made.close()


@pytest.fixture
def login(tmp_path: Path) -> Path:
    file = tmp_path / "login"
    file.write_text(LOGIN + "\n")
    return file


def client(camera: RtspCamera, timeout_s: float = 10.0, token_file: Path | None = None) -> RtspClient:
    return RtspClient(RtspOptions(url=camera.url, timeout_s=timeout_s, token_file=token_file), SystemClock())


def code_of(camera: RtspCamera, timeout_s: float = 1.0) -> str:
    found = client(camera, timeout_s).picture()
    assert isinstance(found, Finding)
    return found.code


class Streamed:
    """A service whose camera streams."""

    def __init__(self, base: Path, url: str) -> None:
        settings = new_settings(base, source="rtsp", rtsp={"url": url})
        upgrade(settings.database)
        archive = open_archive(settings.archive)
        self.clock = MorningClock()
        self.service = Service(settings, archive=archive, clock=self.clock, open_camera=never)  # type: ignore[arg-type]

    def take(self) -> set[str]:
        assert self.service.snapshots is not None
        self.clock.advance(10.0)
        self.service.snapshots.take()
        return {reason.code for reason in self.service.board.snapshot().reasons}


@pytest.fixture
def streamed(tmp_path: Path, camera: RtspCamera) -> Iterator[Streamed]:
    made = Streamed(tmp_path, camera.url)
    yield made
    made.service.archive.close()


def test_the_sun_of_a_stream_is_stored_with_the_bound_of_its_time(streamed: Streamed) -> None:
    assert streamed.take() == set()
    (point,) = streamed.service.archive.sightings.find("roof")
    assert point.verdict == "clear"
    assert MORNING < point.time < MORNING + timedelta(seconds=22.0)
    assert point.clock_error_s is not None
    assert 1.52 < point.clock_error_s < 1.8  # the host's 0.02 s, what is stated, and half of one frame's wait
    assert (point.x_px, point.y_px) == pytest.approx(LENS.pixel(*sun_at(MORNING)), abs=0.7)


def test_a_frame_is_no_older_than_the_bound_of_its_time(camera: RtspCamera) -> None:
    """The picture becomes bright at a known moment, while the stream is being opened or read."""
    clock, stop, changes = SystemClock(), threading.Event(), list[tuple[datetime, int]]()

    def brighten() -> None:
        level = 0
        while not stop.wait(0.1):
            level = (level + 3) % 240
            changes.append((clock.now(), level))
            camera.image = np.full((320, 320, 3), level, np.uint8)

    threading.Thread(target=brighten, daemon=True).start()
    found = client(camera).picture()
    stop.set()
    assert not isinstance(found, Finding)
    level = _mean(found.content)
    made, _ = min(changes, key=lambda one: abs(one[1] - level))
    late_s = (found.time - made).total_seconds()
    assert abs(late_s) < found.within_s + 0.35  # the server sends a picture up to 0.1 s after it was made


@pytest.mark.parametrize("codec", ["H264", "H265"])
def test_of_a_stream_of_changes_a_key_frame_is_taken(camera: RtspCamera, codec: str) -> None:
    camera.codec = codec
    found = client(camera).picture()
    assert not isinstance(found, Finding)
    assert _mean(found.content) == pytest.approx(40.0, abs=4.0)  # the frames between are 60 to 180
    early_s = min(abs((found.time - sent).total_seconds()) for sent, frame in camera.sent if frame == 0)
    assert early_s < found.within_s + 0.35


def _mean(content: bytes) -> float:
    return float(np.asarray(Image.open(io.BytesIO(content))).mean())


@pytest.mark.parametrize("basic", [False, True])
def test_the_login_of_a_file_is_given_and_never_shown(
    camera: RtspCamera, login: Path, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture, *, basic: bool
) -> None:
    camera.login, camera.basic = LOGIN, basic
    found = client(camera, token_file=login).picture()
    assert not isinstance(found, Finding)
    camera.login = "ow@ner:another"
    refused = client(camera, token_file=login).picture()
    assert isinstance(refused, Finding)
    assert refused.code == "rtsp_denied"
    shown = "".join(capfd.readouterr()) + caplog.text + repr(refused)
    assert "sec" not in shown.replace("second", "")
    assert "c2Vj" not in shown
    assert code_of(camera) == "rtsp_denied"
    assert not any("sec" in one.partition("\n")[0] for one in camera.asked)


def test_a_redirect_is_not_followed(camera: RtspCamera, login: Path) -> None:
    camera.status, camera.headers = 302, "Location: rtsp://elsewhere.example/stream\r\n"
    found = client(camera, token_file=login).picture()
    assert isinstance(found, Finding)
    assert found.code == "rtsp_status"
    assert {one.partition(" ")[0] for one in camera.asked} == {"DESCRIBE"}


def test_a_path_that_is_none(camera: RtspCamera) -> None:
    camera.status = 404
    assert code_of(camera) == "rtsp_status"


@pytest.mark.parametrize(
    ("fault", "code"),
    [("silent", "rtsp_unreachable"), ("garbage", "rtsp_unreachable"), ("drips", "rtsp_no_frame")],
)
def test_a_server_that_gives_nothing_is_left_in_time(camera: RtspCamera, fault: str, code: str) -> None:
    setattr(camera, fault, True)
    clock, before = SystemClock(), threading.active_count()
    began_s = clock.monotonic()
    assert code_of(camera) == code
    assert clock.monotonic() - began_s < 6.0
    assert threading.active_count() <= before + 4  # those of the server


def test_a_stream_without_a_frame(camera: RtspCamera) -> None:
    camera.image = None
    assert code_of(camera) == "rtsp_no_frame"


def test_a_stream_of_too_many_pixels_is_not_decoded(camera: RtspCamera, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rtsp, "MOST_PIXELS", 320 * 320 - 1)
    assert code_of(camera) == "rtsp_too_many_pixels"
    monkeypatch.setattr(rtsp, "MOST_PIXELS", 320 * 320)
    assert isinstance(client(camera).picture(), Snapshot)


def test_a_port_that_is_closed() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        url = f"rtsp://127.0.0.1:{taken.getsockname()[1]}/stream"
        found = RtspClient(RtspOptions(url=url), SystemClock()).picture()
    assert isinstance(found, Finding)
    assert found.code == "rtsp_unreachable"


def test_a_frozen_stream_and_one_of_another_size_are_conditions(streamed: Streamed, camera: RtspCamera) -> None:
    assert streamed.take() == set()
    assert [streamed.take() for _ in range(3)][-1] == {"camera_frozen"}
    camera.image = picture(MORNING, Lens(size=400), np.random.default_rng(2))
    assert "rtsp_refused" in streamed.take()
    camera.image = picture(MORNING, LENS, np.random.default_rng(3))
    assert streamed.take() == set()
    assert [one.verdict for one in streamed.service.archive.sightings.find("roof")] == [
        *("clear", "frozen", "frozen", "frozen", "clear")
    ]


def test_a_stream_that_is_frozen_under_a_clock_that_runs_is_told(streamed: Streamed, camera: RtspCamera) -> None:
    still = picture(MORNING, LENS, np.random.default_rng(1))
    shown = []
    for n in range(5):
        camera.image = with_clock(still, n)
        shown.append(streamed.take())
    assert shown[-1] == {"camera_frozen"}
    assert [one.verdict for one in streamed.service.archive.sightings.find("roof")][1:] == 4 * ["frozen"]


def test_a_login_that_the_decoder_would_send_as_basic_is_not_sent(camera: RtspCamera, login: Path) -> None:
    camera.status = 401
    digest = 'Digest realm="c", nonce="n"'
    both = f"{digest}\r\nWWW-Authenticate: {digest}, algorithm=SHA-256"
    for challenge in (f'Basic realm="c", {digest}', both):
        camera.headers = f"WWW-Authenticate: {challenge}\r\n"
        found = client(camera, token_file=login).picture()
        assert isinstance(found, Finding)
        assert found.code == "rtsp_login"
    assert not any("Authorization" in one for one in camera.asked)


@pytest.mark.parametrize("url", ["http://camera/", "rtsp://", "rtsp://user:secret@camera/", "rtsps://camera/"])
def test_an_address_that_is_none_is_refused(url: str) -> None:
    with pytest.raises(InputError) as refused:
        RtspOptions(url=url)
    assert refused.value.field == "rtsp.url"
    assert "secret" not in str(refused.value)


def test_a_token_file_without_a_password_is_refused(camera: RtspCamera, login: Path) -> None:
    login.write_text("owner")
    with pytest.raises(ConfigurationError, match=r"rtsp\.token_file"):
        client(camera, token_file=login)
