"""A simulated camera of ordinary pictures: it writes them into a folder, or gives the present one by HTTP."""

from __future__ import annotations

import hashlib
import json
import math
import secrets
import threading
import urllib.request
from base64 import b64decode
from collections.abc import Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, field
from datetime import datetime
from email.utils import format_datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np

from sunarc.common.errors import OutsideError
from sunarc.common.utc import DAY_S, utc_time
from sunarc.imager.runtime.clock import Clock
from sunarc.lab.simulation.imager import truth_document
from sunarc.lab.simulation.made_archive import MadeArchive, MadeCamera, camera_at, encoded, photograph
from sunarc.lab.simulation.options import Bump
from sunarc.lab.simulation.scene import bumped_camera
from sunarc.lab.simulation.truth import SGP
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

_LOWEST_PICTURE_DEG = 88.0
_LATEST = "image.jpg"
"""The copy of the newest picture that programs such as allsky write over, for a web page."""
PATHS = ("/record/current.jpg", "/axis-cgi/jpg/image.cgi")
"""Where Mobotix and Axis cameras have their present picture."""
_REALM = "camera"


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureOptions:
    """A simulated camera of pictures.

    Attributes
    ----------
    start : time of the first picture, aware.
    speed : times faster than real.
    cadence_s : simulated seconds from one picture of a folder to the next.
    size : side of the pictures, px.
    site : where the camera stands.
    cloudy_share : share of the pictures in which a cloud hides the sun.
    seed : of clouds and noise.
    truth : file for the true camera, a calibration document; None writes none.
    bump : when the camera is turned, if it is.
    """

    start: datetime
    speed: float = 1.0
    cadence_s: float = 60.0
    size: int = 640
    site: Site = field(default_factory=lambda: SGP)
    cloudy_share: float = 0.2
    seed: int = 1
    truth: Path | None = None
    bump: Bump | None = None


def write_pictures(options: PictureOptions, folder: Path, clock: Clock, stop: threading.Event) -> None:
    """Write picture after picture as allsky does, in a folder a day, until stopped; the nights are skipped."""
    camera = _options_camera(options)
    folder.mkdir(parents=True, exist_ok=True)
    _write_truth(options, camera)
    rng = np.random.default_rng(options.seed)
    began_s = clock.monotonic()
    times = _times_with_sun(options.start.timestamp(), options.cadence_s, options.site)
    for written, unix_s in enumerate(times):
        picture = _make_picture(options, camera, unix_s, rng)
        due_s = began_s + written * options.cadence_s / options.speed
        if clock.wait(stop, max(0.0, due_s - clock.monotonic())):
            return
        _write_picture(folder, utc_time(unix_s), picture)


def _options_camera(options: PictureOptions) -> Camera:
    made = MadeArchive(cameras=(), size=options.size, site=options.site)
    return camera_at(made, MadeCamera(name="pictures", naming=""), options.start.timestamp())


def _write_truth(options: PictureOptions, camera: Camera) -> None:
    if options.truth is not None:
        document = truth_document(camera, options.site, name="pictures", created_at=options.start)
        options.truth.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _make_picture(options: PictureOptions, camera: Camera, unix_s: float, rng: np.random.Generator) -> bytes:
    bump = options.bump
    if bump is not None and unix_s >= bump.at.timestamp():
        camera = bumped_camera(camera, bump)
    pixel = project(camera, sun_directions([unix_s], options.site)[0])
    hidden = bool(rng.random() < options.cloudy_share)
    return encoded(photograph(options.size, pixel, rng, hidden=hidden))


def _times_with_sun(unix_s: float, cadence_s: float, site: Site) -> Iterator[float]:
    """Yield times from one on, seconds since 1970-01-01 UTC, for ever: the sun is up in all."""
    while True:
        day = unix_s + cadence_s * np.arange(math.ceil(DAY_S / cadence_s))
        up = np.asarray(sun_angles(day, site).apparent_zenith) < _LOWEST_PICTURE_DEG
        yield from day[up].tolist()
        unix_s = float(day[-1]) + cadence_s


def _write_picture(folder: Path, time: datetime, picture: bytes) -> None:
    """Write a picture as such programs do: into place, and over the newest one."""
    day = folder / f"{time:%Y%m%d}"
    day.mkdir(exist_ok=True)
    for path in (day / f"image-{time:%Y%m%d%H%M%S}.jpg", folder / _LATEST):
        path.write_bytes(picture)


# The same camera by HTTP.


@dataclass(eq=False)
class PresentPicture:
    """The picture of now, of a whole second of the simulated time; the nights are skipped.

    Parameters
    ----------
    options : of the camera.
    clock : passes the time.
    """

    options: PictureOptions
    clock: Clock

    def __post_init__(self) -> None:
        """Begin at the start."""
        self.camera = _options_camera(self.options)
        self._lock = threading.Lock()
        self._skipped_s, self._began_s = 0.0, self.clock.monotonic()
        self._newest: tuple[int, bytes] | None = None

    def now(self) -> tuple[datetime, bytes]:
        """Return the time of the picture, and the picture as a JPEG."""
        options = self.options
        with self._lock:
            passed_s = (self.clock.monotonic() - self._began_s) * options.speed + self._skipped_s
            now_s = options.start.timestamp() + passed_s
            with_sun_s = next(_times_with_sun(now_s, 60.0, options.site))
            self._skipped_s += with_sun_s - now_s
            second = math.floor(with_sun_s)
            if self._newest is None or self._newest[0] != second:
                rng = np.random.default_rng((options.seed, second))
                self._newest = (second, _make_picture(options, self.camera, second, rng))
            return utc_time(second), self._newest[1]


@dataclass(eq=False)
class PictureServer:
    """Answers of a Mobotix or Axis camera to a request for its present picture.

    Parameters
    ----------
    present : gives the picture.
    login : user and password, asked for as Digest (MD5) or Basic, as the client chooses; None asks for none.
    """

    present: PresentPicture
    _: KW_ONLY
    login: tuple[str, str] | None = None

    def __post_init__(self) -> None:
        """Draw the nonce of the challenges."""
        self._nonce = secrets.token_hex(16)

    def answer(self, path: str, authorization: str | None) -> tuple[int, list[tuple[str, str]], bytes]:
        """Return the status, the headers and the body for a GET."""
        if path.partition("?")[0] not in PATHS:
            return 404, [], b""
        if not self._permits_request(path, authorization):
            digest = f'Digest realm="{_REALM}", nonce="{self._nonce}", algorithm=MD5, qop="auth"'
            return 401, [("WWW-Authenticate", digest), ("WWW-Authenticate", f'Basic realm="{_REALM}"')], b""
        time, picture = self.present.now()
        stated = format_datetime(time, usegmt=True)
        headers = [("Content-Type", "image/jpeg"), ("Date", stated), ("Last-Modified", stated)]
        return 200, headers, picture

    def _permits_request(self, path: str, authorization: str | None) -> bool:
        if self.login is None:
            return True
        scheme, _, given = (authorization or "").partition(" ")
        if scheme.lower() == "basic":
            try:
                return secrets.compare_digest(b64decode(given), ":".join(self.login).encode())
            except ValueError:
                return False
        fields = urllib.request.parse_keqv_list([one for one in urllib.request.parse_http_list(given) if "=" in one])
        return scheme.lower() == "digest" and self._is_response(path, fields)

    def _is_response(self, path: str, fields: Mapping[str, str]) -> bool:
        """Return whether the fields answer the challenge of Digest (RFC 7616, MD5, qop "auth")."""
        user, password = self.login or ("", "")
        if (fields.get("uri"), fields.get("nonce"), fields.get("username")) != (path, self._nonce, user):
            return False
        parts = [self._nonce, *(fields.get(name, "") for name in ("nc", "cnonce", "qop"))]
        expected = _md5(_md5(user, _REALM, password), *parts, _md5("GET", path))
        return secrets.compare_digest(fields.get("response", "").encode(), expected.encode())


def _md5(*parts: str) -> str:
    return hashlib.md5(":".join(parts).encode(), usedforsecurity=False).hexdigest()


def serve_pictures(server: PictureServer, address: tuple[str, int], stop: threading.Event) -> None:
    """Serve the present picture at an address (host, port) until stopped.

    Raises
    ------
    OutsideError : the address cannot be used.
    """

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            status, headers, body = server.answer(self.path, self.headers.get("Authorization"))
            self.send_response_only(status)
            for name, value in (*headers, ("Content-Length", str(len(body)))):
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            pass

    try:
        listening = ThreadingHTTPServer(address, Handler)
    except (OSError, OverflowError) as error:
        raise OutsideError(f"cannot listen at {address[0]}:{address[1]}: {error}") from error
    with listening:
        _write_truth(server.present.options, server.present.camera)
        thread = threading.Thread(target=listening.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
        thread.start()
        stop.wait()
        listening.shutdown()
        thread.join()
