"""A camera that is asked by HTTP: its pictures are dated by this host, and what is no picture of now is refused."""

from __future__ import annotations

import base64
import hashlib
import ssl
import struct
import subprocess
import threading
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.fixtures.settings import new_settings
from tests.imager.live import exchange_fuzz
from tests.imager.live.followed import never, serve_calibration_of
from tests.imager.live.sky_pictures import Lens, jpeg, picture, sun_at, with_clock

from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.imager.app.service import Service
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.cameras.options import SnapshotOptions
from sunarc.imager.live.snapshots import Snapshot, SnapshotClient
from sunarc.imager.runtime.clock import VirtualClock

MORNING = datetime(2025, 5, 13, 15, 0, tzinfo=UTC)
LENS = Lens()
Answer = Callable[[BaseHTTPRequestHandler], None]


def sent(content: bytes, kind: str = "image/jpeg", **headers: str) -> Answer:
    def answer(request: BaseHTTPRequestHandler) -> None:
        request.send_response_only(200)
        for name, value in {"Content-Type": kind, "Content-Length": str(len(content)), **headers}.items():
            request.send_header(name.replace("_", "-"), value)
        request.end_headers()
        request.wfile.write(content)

    return answer


class Camera:
    """A camera's web server on loopback, whose answer is set."""

    def __init__(self, certificate: Path | None = None) -> None:
        camera = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                camera.asked.append((self.path, self.headers.get("Authorization")))
                with suppress(BrokenPipeError, ConnectionResetError):
                    camera.answer(self)

            def log_message(self, *_: object) -> None:
                pass

        self.asked: list[tuple[str, str | None]] = []
        self.answer: Answer = sent(b"")
        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        if certificate is not None:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            context.load_cert_chain(certificate)
            self.server.socket = context.wrap_socket(self.server.socket, server_side=True)
        threading.Thread(target=self.server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True).start()

    @property
    def port(self) -> int:
        return int(self.server.server_address[1])

    def close(self) -> None:
        self.server.shutdown()
        self.server.server_close()


@pytest.fixture
def camera() -> Iterator[Camera]:
    made = Camera()
    yield made
    made.close()


class Asked:
    """A service that asks a camera, in virtual time."""

    def __init__(
        self, base: Path, url: str, *, start: datetime = MORNING, cadence_s: float = 30.0, **options: object
    ) -> None:
        settings = new_settings(base, source="http", http={"url": url, **options}, capture={"cadence_s": cadence_s})
        upgrade(settings.database)
        self.clock = VirtualClock(start)
        archive = open_archive(settings.archive)
        self.service = Service(settings, archive=archive, clock=self.clock, open_camera=never)  # type: ignore[arg-type]

    def take(self) -> None:
        assert self.service.snapshots is not None
        self.service.snapshots.take()
        self.clock.advance(30.0)

    def codes(self) -> set[str]:
        return {reason.code for reason in self.service.board.snapshot().reasons}


@pytest.fixture
def asked(tmp_path: Path, camera: Camera) -> Iterator[Asked]:
    made = Asked(tmp_path, f"http://127.0.0.1:{camera.port}/snapshot.jpg")
    yield made
    made.service.archive.close()


def shot(time: datetime) -> bytes:
    return jpeg(picture(time, LENS, np.random.default_rng(int(time.timestamp()))))


def test_pictures_are_dated_by_the_host_and_stored(asked: Asked, camera: Camera, tmp_path: Path) -> None:
    for _ in range(3):
        camera.answer = sent(shot(asked.clock.now()))
        asked.take()
    points = asked.service.archive.sightings.find("roof")
    assert [point.time for point in points] == [MORNING + timedelta(seconds=30 * n) for n in range(3)]
    assert {point.verdict for point in points} == {"clear"}
    assert {point.clock_error_s for point in points} == {1.02}  # the host's 0.02 s and what is stated
    for point in points:
        assert (point.x_px, point.y_px) == pytest.approx(LENS.pixel(*sun_at(point.time)), abs=0.5)
    assert asked.codes() == set()
    assert [path.name for path in (tmp_path / "state" / "snapshots").iterdir()] == ["20250513T150100.000Z_hdr.jpg"]
    assert not list((tmp_path / "state").glob("images/*/*/*/*"))


def test_sightings_from_before_the_first_calibration_are_held_to_it(asked: Asked, camera: Camera) -> None:
    elsewhere = Lens(turn_deg=60.0)
    for n in range(6):
        now = asked.clock.now()
        camera.answer = sent(jpeg(picture(now, elsewhere if n == 2 else LENS, np.random.default_rng(n))))
        asked.take()
    find = asked.service.archive.sightings.find
    assert [point.accepted for point in find("roof", ingest_pass=1)] == 6 * [True]
    serve_calibration_of(asked.service, LENS, MORNING - timedelta(hours=2))
    camera.answer = sent(shot(asked.clock.now()))
    asked.take()
    assert [(point.accepted, point.ingest_pass) for point in find("roof")] == [(n != 2, 2) for n in range(7)]
    (refused,) = find("roof", accepted=False)
    assert (refused.verdict, [one.code for one in refused.findings]) == ("reflection", ["blob_displaced"])


def test_pictures_are_kept_where_that_is_set(camera: Camera, tmp_path: Path) -> None:
    asked = Asked(tmp_path, f"http://127.0.0.1:{camera.port}/", keep_images=True)
    camera.answer = sent(shot(MORNING))
    asked.take()
    (kept,) = (tmp_path / "state").glob("images/*/*/*/*")
    assert kept.read_bytes() == shot(MORNING)
    assert asked.service.latest_image() == kept
    asked.service.archive.close()


def test_a_disk_without_room_costs_kept_pictures_and_no_sighting(camera: Camera, tmp_path: Path) -> None:
    asked = Asked(tmp_path, f"http://127.0.0.1:{camera.port}/", keep_images=True)
    free_bytes = 1_199_000_000
    asked.service.images._free_bytes = lambda _: free_bytes
    for _ in range(3):
        camera.answer = sent(shot(asked.clock.now()))
        asked.take()
    points = asked.service.archive.sightings.find("roof")
    assert [(point.time, point.accepted) for point in points] == [
        (MORNING + timedelta(seconds=30 * n), True) for n in range(3)
    ]
    assert asked.codes() == {"images_not_written"}
    assert [path.name for path in (tmp_path / "state" / "snapshots").iterdir()] == ["20250513T150100.000Z_hdr.jpg"]
    free_bytes = 10_000_000_000
    camera.answer = sent(shot(asked.clock.now()))
    asked.take()
    assert len(list((tmp_path / "state").glob("images/*/*/*/*"))) == 1
    assert asked.codes() == set()
    assert len(asked.service.archive.sightings.find("roof", accepted=True)) == 4
    asked.service.archive.close()


def endless(request: BaseHTTPRequestHandler) -> None:
    request.send_response_only(200)
    request.end_headers()
    while True:
        request.wfile.write(bytes(1 << 20))


def status(code: int, **headers: str) -> Answer:
    def answer(request: BaseHTTPRequestHandler) -> None:
        request.send_response_only(code)
        for name, value in {"Content-Length": "0", **headers}.items():
            request.send_header(name.replace("_", "-"), value)
        request.end_headers()

    return answer


def bomb(side: int) -> bytes:
    """Return the PNG of a black square: some kB that would be gigabytes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(bytes(1 << 16)))
        + chunk(b"IEND", b"")
    )


OLD = {"Date": "Tue, 13 May 2025 15:00:00 GMT", "Last_Modified": "Tue, 13 May 2025 14:00:00 GMT"}


@pytest.mark.parametrize(
    ("answer", "code"),
    [
        (sent(b"<html>log in</html>", "text/html"), "http_no_picture"),
        (sent(b""), "http_no_picture"),
        (endless, "http_too_large"),
        (status(401, WWW_Authenticate='Basic realm="camera"'), "http_denied"),
        (status(404), "http_status"),
        (status(302, Location="http://elsewhere.example/snapshot.jpg"), "http_redirected"),
        (sent(bomb(11_000)), "http_too_many_pixels"),
        (sent(bomb(60_000)), "http_too_many_pixels"),
        (sent(shot(MORNING), **OLD), "http_stale"),
        (sent(shot(MORNING), Age="3000"), "http_stale"),
        (sent(shot(MORNING)[:4000]), "http_refused"),
        (lambda request: request.connection.close(), "http_unreachable"),
    ],
)
@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
def test_what_is_no_picture_of_now_is_a_condition_until_there_is_one(
    asked: Asked, camera: Camera, answer: Answer, code: str
) -> None:
    camera.answer = answer
    asked.take()
    assert asked.codes() == {code}
    assert [p for p in asked.service.archive.sightings.find("roof") if p.accepted] == []
    camera.answer = sent(shot(asked.clock.now()))
    asked.take()
    assert asked.codes() == set()
    assert [point.verdict for point in asked.service.archive.sightings.find("roof")] == ["clear"]


def raw(head: bytes, content: bytes = b"") -> Answer:
    """Return an answer of these very bytes."""

    def answer(request: BaseHTTPRequestHandler) -> None:
        request.wfile.write(head + b"\r\nContent-Length: %d\r\n\r\n" % len(content) + content)

    return answer


OK, FAR = b"HTTP/1.1 200 OK\r\n", b"Tue, 13 May 20250000000 15:00:00 GMT"


@pytest.mark.parametrize(
    ("answer", "code"),
    [
        (raw(b"HTTP/1.1 401 No\r\nWWW-Authenticate: Digest foo"), "http_login"),
        (raw(b'HTTP/1.1 401 No\r\nWWW-Authenticate: Digest realm="c", nonce="n", qop='), "http_denied"),
        (raw(b"HTTP/1.1 401 No\r\nWWW-Authenticate: Negotiate"), "http_login"),
        (raw(b"HTTP/1.1 302 Found\r\nLocation: http://["), "http_redirected"),
        (raw(b"HTTP/1.1 302 Found\r\nLocation: /caf\xe9"), "http_status"),
        (raw(b"HTTP/1.1 302 Found\r\nLocation: http://\xe9lsewhere/"), "http_redirected"),
        (raw(OK + b"Date: " + FAR + b"\r\nLast-Modified: " + FAR, b"no picture"), "http_no_picture"),
        (raw(OK + b"Age: " + b"9" * 400, shot(MORNING)), "http_stale"),
        (raw(b"HTTP/1.1 200 OK\r\nno colon"), "http_unreachable"),
        (raw(b"ICY 200 OK"), "http_unreachable"),
    ],
)
def test_an_answer_that_is_damaged_is_a_failed_slot(camera: Camera, tmp_path: Path, answer: Answer, code: str) -> None:
    (tmp_path / "login").write_text("owner:secret\n")
    asked = Asked(tmp_path, f"http://127.0.0.1:{camera.port}/", token_file=tmp_path / "login")
    camera.answer = answer
    asked.take()
    assert asked.codes() == {code}
    assert not any(given and given.startswith("Basic") for _, given in camera.asked)
    camera.answer = raw(OK + b"Date: " + FAR + b"\r\nLast-Modified: " + FAR, shot(asked.clock.now()))
    asked.take()
    assert asked.codes() == set()
    asked.service.archive.close()


def test_whatever_a_camera_answers_and_files_are_named_nothing_is_raised() -> None:
    codes = exchange_fuzz.ask(400, seed=1)
    assert {"picture", "http_unreachable", "http_login", "http_redirected", "rtsp_login"} <= set(codes)
    names = exchange_fuzz.read_names(400, seed=1)
    assert {"dated", "file_time_unknown", "file_time_range"} <= set(names)
    assert names["out of range"] == 0


def test_where_the_cameras_clock_is_followed_a_picture_without_its_time_is_none(camera: Camera) -> None:
    options = SnapshotOptions(url=f"http://127.0.0.1:{camera.port}/")
    client = SnapshotClient(options, VirtualClock(MORNING), dated_by_camera=True)
    camera.answer = sent(shot(MORNING))
    refused = client.picture()
    assert isinstance(refused, Finding)
    assert refused.code == "http_no_picture"
    stated = "Mon, 13 May 2013 15:00:00 GMT"
    camera.answer = sent(shot(MORNING), Date=stated, Last_Modified=stated)
    found = client.picture()
    assert isinstance(found, Snapshot)
    assert (found.time, found.within_s) == (datetime(2013, 5, 13, 15, tzinfo=UTC), 0.0)


def test_a_camera_that_serves_one_picture_for_an_hour_is_frozen(asked: Asked, camera: Camera) -> None:
    camera.answer = sent(shot(MORNING))
    for _ in range(6):
        asked.take()
    assert [point.verdict for point in asked.service.archive.sightings.find("roof")] == ["clear"] + 5 * ["frozen"]
    assert asked.codes() == {"camera_frozen"}


def with_comment(content: bytes, text: bytes) -> bytes:
    """Return a JPEG with a comment, as cameras write the time into it."""
    return content[:2] + b"\xff\xfe" + struct.pack(">H", len(text) + 2) + text + content[2:]


@pytest.mark.parametrize("calibrated", [False, True])
@pytest.mark.parametrize("text", ["comment", "burnt in"])
def test_a_picture_that_is_frozen_under_text_that_changes_is_frozen(
    asked: Asked, camera: Camera, text: str, *, calibrated: bool
) -> None:
    if calibrated:
        camera.answer = sent(shot(asked.clock.now()))
        asked.take()
        serve_calibration_of(asked.service, LENS, MORNING - timedelta(hours=2))
    began = len(asked.service.archive.sightings.find("roof"))
    still = picture(asked.clock.now(), LENS, np.random.default_rng(3))
    for n in range(6):
        shown = with_comment(jpeg(still), b"%d" % n) if text == "comment" else jpeg(with_clock(still, n))
        camera.answer = sent(shown)
        asked.take()
    assert [one.verdict for one in asked.service.archive.sightings.find("roof")][began + 1 :] == 5 * ["frozen"]
    assert asked.codes() == {"camera_frozen"}
    assert [event.kind for event in asked.service.archive.events.find("roof", severity="alarm")] == ["camera_frozen"]
    camera.answer = sent(shot(asked.clock.now()))
    asked.take()
    assert asked.codes() == set()


def test_clouds_that_are_frozen_under_text_are_known_by_the_noise_that_stands_still(
    asked: Asked, camera: Camera
) -> None:
    for n in range(12):
        camera.answer = sent(jpeg(picture(asked.clock.now(), LENS, np.random.default_rng(n), cloud=True)))
        asked.take()
    assert asked.codes() == set()
    for n in range(4):
        still = picture(MORNING, LENS, np.random.default_rng(99), cloud=True)
        camera.answer = sent(jpeg(with_clock(still, n)))
        asked.take()
    assert asked.codes() == {"camera_frozen"}


@pytest.mark.parametrize("level", [0, 2, 255])
def test_a_black_or_overexposed_picture_with_a_clock_is_not_frozen(asked: Asked, camera: Camera, level: int) -> None:
    for n in range(140):
        camera.answer = sent(jpeg(with_clock(np.full((320, 320, 3), level, np.uint8), n)))
        asked.take()
    assert asked.codes() == set()


def smeared(image: np.ndarray) -> np.ndarray:
    image[120:] = image[120]
    return image


def of_four_bits(image: np.ndarray) -> np.ndarray:
    return image & 0xF0


@pytest.mark.parametrize(
    ("damaged", "code"), [(smeared, "image_rows_repeated"), (of_four_bits, "image_levels_missing")]
)
def test_rows_and_bits_that_are_missing_are_said(
    asked: Asked, camera: Camera, damaged: Callable[[np.ndarray], np.ndarray], code: str
) -> None:
    for n in range(4):
        image = damaged(picture(asked.clock.now(), LENS, np.random.default_rng(n)))
        camera.answer = sent(cv2.imencode(".png", image)[1].tobytes(), "image/png")
        asked.take()
    assert asked.codes() == {code}
    camera.answer = sent(shot(asked.clock.now()))
    asked.take()
    assert asked.codes() == set()


def test_basic_and_digest_are_answered_with_the_login_of_a_file_and_never_before(
    camera: Camera, tmp_path: Path
) -> None:
    (tmp_path / "login").write_text("owner:secret:1\n")
    asked = Asked(tmp_path, f"http://127.0.0.1:{camera.port}/a?b=1", token_file=tmp_path / "login")

    def basic(request: BaseHTTPRequestHandler) -> None:
        right = request.headers.get("Authorization") == "Basic " + base64.b64encode(b"owner:secret:1").decode()
        (sent(shot(MORNING)) if right else status(401, WWW_Authenticate='Basic realm="c"'))(request)

    def digest(request: BaseHTTPRequestHandler) -> None:
        given = request.headers.get("Authorization") or ""
        fields = dict(part.strip().split("=", 1) for part in given.removeprefix("Digest ").split(",") if "=" in part)
        at = {name: value.strip('"') for name, value in fields.items()}
        first = hashlib.md5(b"owner:c:secret:1").hexdigest()  # noqa: S324 - as cameras ask
        second = hashlib.md5(b"GET:/a?b=1").hexdigest()  # noqa: S324
        text = ":".join([first, "n1", at.get("nc", ""), at.get("cnonce", ""), "auth", second])
        right = at.get("response") == hashlib.md5(text.encode()).hexdigest()  # noqa: S324
        challenge = 'Digest realm="c", nonce="n1", qop="auth", algorithm=MD5'
        (sent(shot(MORNING + timedelta(seconds=30))) if right else status(401, WWW_Authenticate=challenge))(request)

    for answer in (basic, digest):
        camera.asked.clear()
        camera.answer = answer
        asked.take()
        assert [given is None for _, given in camera.asked] == [True, False]
    assert [point.verdict for point in asked.service.archive.sightings.find("roof")] == ["clear", "clear"]
    camera.answer = status(401, WWW_Authenticate='Basic realm="c"')
    asked.take()
    assert asked.codes() == {"http_denied"}
    asked.service.archive.close()


def test_a_certificate_is_verified_and_the_cameras_own_can_be_named(tmp_path: Path) -> None:
    both = tmp_path / "camera.pem"
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "9", "-subj", "/CN=127.0.0.1"]
    command += ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(both), "-out", str(tmp_path / "own.pem")]
    subprocess.run(command, check=True, capture_output=True)
    both.write_bytes(both.read_bytes() + (tmp_path / "own.pem").read_bytes())
    camera = Camera(both)
    camera.answer = sent(shot(MORNING))
    codes = []
    for base, ca_file in (("a", None), ("b", tmp_path / "own.pem")):
        (tmp_path / base).mkdir()
        asked = Asked(tmp_path / base, f"https://127.0.0.1:{camera.port}/", ca_file=ca_file)
        asked.take()
        codes.append(asked.codes())
        asked.service.archive.close()
    camera.close()
    assert codes == [{"http_certificate"}, set()]


def test_a_new_certificate_file_is_read_without_a_restart_and_a_broken_one_changes_nothing(tmp_path: Path) -> None:
    named = tmp_path / "ca.pem"
    for name in ("first", "second"):
        command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "9", "-subj", "/CN=127.0.0.1"]
        command += ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(tmp_path / f"{name}.both")]
        subprocess.run([*command, "-out", str(tmp_path / f"{name}.pem")], check=True, capture_output=True)
        both = tmp_path / f"{name}.both"
        both.write_bytes(both.read_bytes() + (tmp_path / f"{name}.pem").read_bytes())
    named.write_bytes((tmp_path / "first.pem").read_bytes())
    camera = Camera(tmp_path / "second.both")
    camera.answer = sent(shot(MORNING))
    asked = Asked(tmp_path, f"https://127.0.0.1:{camera.port}/", ca_file=named)
    codes = []
    for content in (None, "second", None, "broken"):
        if content is not None:
            new = tmp_path / "new"
            new.write_bytes(b"none" if content == "broken" else (tmp_path / f"{content}.pem").read_bytes())
            new.replace(named)
        asked.take()
        codes.append(asked.codes())
    camera.close()
    asked.service.archive.close()
    assert codes == [{"http_certificate"}, set(), set(), set()]


@pytest.mark.parametrize("url", ["ftp://camera/", "http://", "http://user:secret@camera/", "http://ca mera/", "camera"])
def test_an_address_that_is_none_is_refused(url: str) -> None:
    with pytest.raises(InputError) as refused:
        SnapshotOptions(url=url)
    assert refused.value.field == "http.url"
    assert "secret" not in str(refused.value)
