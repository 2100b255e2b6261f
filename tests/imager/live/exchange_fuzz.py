"""Ask a camera that answers anything: each answer is a picture or a finding with a code, and nothing is raised.

    .venv/bin/python -m tests.imager.live.exchange_fuzz --count 10000 --seed 1

draws answers of status lines, headers, challenges, redirects, dates, bodies and encodings that are sound, odd or
damaged, and names of files with odd dates; printed is how often each code came.
"""

from __future__ import annotations

import argparse
import io
import json
import random
import socketserver
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from sunarc.common.findings import Finding, FindingError
from sunarc.common.foreign_files import name_text
from sunarc.imager.cameras.options import RtspOptions, SnapshotOptions
from sunarc.imager.live.rtsp import RtspClient
from sunarc.imager.live.snapshots import SnapshotClient
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.sky.days import solar_date
from sunarc.sources.file_kinds import find_kind
from sunarc.sources.image_times import TimeRules, timed_frames
from sunarc.sources.sources import Folder

NOW = datetime(2025, 5, 13, 15, 0, tzinfo=UTC)
NUMBERS = (b"", b"0", b"-1", b"1e9", b"9" * 11, b"9" * 400, b"\xb2", b"12", b"0x10", b" 7 ", b"NaN")
DATES = (
    *(b"Tue, 13 May 2025 15:00:00 GMT", b"Tue, 13 May 2025 14:00:00 GMT", b"Tue, 13 May 20250000000 15:00:00 GMT"),
    *(b"Mon, 01 Jan 0001 00:00:00 GMT", b"Mon, 01 Jan 0001 00:00:00 +2359", b"Fri, 31 Dec 9999 23:59:59 -2359"),
    *(b"Tue, 99 Foo 2025 99:99:99 GMT", b"Tue, 13 May 2025 15:00:00 +99999999", b"13", b",", b"\xff\xfe", b"0"),
    *(b"Tue, 13 May 2025 15:00:00 -0000", b"Thu, 01 Jan 1970", b"a b c d e f g h", b"Tue, 13-May-25 15:00:00 GMT"),
)
CHALLENGES = (
    *(b"Digest foo", b"Digest", b"Digest qop=", b'Digest realm="c", nonce="n", qop=', b'Digest realm="c"', b"Basic"),
    *(b'Digest realm="c", nonce="n1", algorithm=SHA-256, qop="auth"', b'Digest realm="c",nonce="n",algorithm="md5"'),
    *(b'Basic realm="x", Digest realm="c", nonce="n"', b'Digest realm="\xff\x01", nonce="\\"', b"NTLM", b"=", b",,,"),
    *(b'Digest realm="c", nonce="n", algorithm=MD5-sess', b'Digest realm="c", nonce="n", algorithm=\xe9, qop="x"'),
    *(b'Digest realm="c', b'Digest realm=c, nonce=n, qop="auth-int", opaque="' + b"o" * 9000 + b'"', b"\x00\x80"),
)
LOCATIONS = (
    *(
        b"http://[",
        b"http://[::1",
        b"/\xff\xfe",
        b"//",
        b"http://\xff/",
        b"?",
        b"/a b\tc",
        b"http://127.0.0.1:99999999/",
    ),
    *(b"http://user:pass@elsewhere/", b"file:///etc/passwd", b"http://x:y/", b"", b"/next", b"\\\\host\\a", b"%"),
    *(b"http://" + b"a" * 300 + b"/", b"http://\xe2\x84\x80/", b"javascript:1", b"http://127.0.0.1:0x10/"),
)
STATUSES = (*9 * (200,), *6 * (401,), 302, 302, 301, 307, 308, 303, 403, 404, 500, 204, 304, 100, 101, 199, 999)
LINES = (
    b"HTTP/1.1 %d OK",
    b"HTTP/1.0 %d",
    b"HTTP/9.9 %d x",
    b"HTTP/1.1 %d \xff",
    b"ICY %d OK",
    b"%d",
    b"RTSP/1.0 %d -",
)


def _picture(kind: str) -> bytes:
    out = io.BytesIO()
    Image.fromarray(np.arange(64 * 64, dtype=np.uint8).reshape(64, 64)).save(out, kind)
    return out.getvalue()


PICTURES = (
    *4 * (_picture("JPEG"),),
    _picture("PNG"),
    _picture("GIF"),
    b"<html>",
    b"",
    bytes(2000),
    b"\xff\xd8\xff" * 99,
)


def _header(draw: random.Random) -> bytes:
    kinds: dict[bytes, tuple[bytes, ...]] = {
        b"Age": NUMBERS,
        **dict.fromkeys((b"Date", b"Last-Modified"), DATES),
        b"WWW-Authenticate": CHALLENGES,
        b"Location": LOCATIONS,
        b"Content-Type": (b"image/jpeg", b"text/html; charset=\xff", b"", b";"),
        b"Content-Encoding": (b"gzip", b"br"),
        b"Connection": (b"close", b"upgrade", b"keep-alive"),
        b"X": (b"\xff", b"\x00", b""),
    }
    name = draw.choice(list(kinds))
    colon = b" : " if draw.random() < 0.02 else b": "
    return name + colon + draw.choice(kinds[name])


def answer(draw: random.Random, *, rtsp: bool = False) -> bytes:
    """Return what a camera may answer: a status line, headers, a body."""
    status = draw.choice(STATUSES[9:] if rtsp else STATUSES)
    sound = b"RTSP/1.0 %d -" if rtsp else LINES[0]
    lines = [(draw.choice(LINES) if draw.random() < 0.1 else sound) % status]
    lines += [_header(draw) for _ in range(draw.randrange(4))]
    if draw.random() < 0.1:
        odd = (b"Transfer-Encoding: gzip", b"Transfer-Encoding: chunked, chunked", b"X \xff: 1", b"no colon")
        lines.append(draw.choice((*odd, b"Content-Length: " + draw.choice(NUMBERS))))
    if status == 401:
        lines += [b"WWW-Authenticate: " + draw.choice(CHALLENGES) for _ in range(draw.randrange(1, 3))]
    if status in {301, 302, 303, 307, 308}:
        lines.append(b"Location: " + draw.choice(LOCATIONS))
    if status == 200:
        lines += [b"Date: " + draw.choice(DATES), b"Last-Modified: " + draw.choice(DATES)]
    body = draw.choice(PICTURES)
    if draw.random() < 0.7:
        body, length = body[: draw.choice((*5 * (len(body),), 40, 300))], len(body)
        lines.append(b"Content-Length: %d" % length)
    elif draw.random() < 0.5:
        lines.append(b"Transfer-Encoding: chunked")
        body = b"%x\r\n%s\r\n" % (len(body), body) + draw.choice(
            (*4 * (b"0\r\n\r\n",), b"", b"-1\r\n", b"zz\r\n", b"f" * 30)
        )
    whole = bytearray((b"\n" if draw.random() < 0.05 else b"\r\n").join([*lines, b"", b""]) + body)
    for _ in range(draw.choice((*8 * (0,), 1, 3))):
        at = draw.randrange(len(whole))
        whole[at : at + draw.randrange(3)] = bytes([draw.randrange(256)])
    return bytes(whole)


@contextmanager
def camera(answers: Callable[[], bytes]) -> Iterator[int]:
    """Run a server on loopback that sends one answer a connection, and yield its port."""

    class Handler(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            head = b""
            with suppress(OSError):
                while b"\r\n\r\n" not in head and (part := self.request.recv(65_536)):
                    head += part
                self.request.sendall(answers())

    with socketserver.TCPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
        thread.start()
        yield int(server.server_address[1])
        server.shutdown()
        thread.join()


def ask(count: int, seed: int) -> Counter[str]:
    """Ask a camera so often by HTTP, and once for five by RTSP; return how often each code came."""
    draw, codes = random.Random(seed), Counter[str]()
    with TemporaryDirectory() as folder, camera(lambda: answer(draw)) as port:
        login = Path(folder) / "login"
        login.write_text("owner:se\u00e9cret\n")
        options = SnapshotOptions(url=f"http://127.0.0.1:{port}/a?b=1", token_file=login)
        clients = [SnapshotClient(options, VirtualClock(NOW), dated_by_camera=dated) for dated in (False, True)]
        for number in range(count):
            codes[_code(clients[number % 2].picture())] += 1
        with camera(lambda: answer(draw, rtsp=True)) as second:
            rtsp = RtspClient(RtspOptions(url=f"rtsp://127.0.0.1:{second}/a", token_file=login), VirtualClock(NOW))
            for _ in range(count // 5):
                codes[_code(rtsp.picture())] += 1
    return codes


def _code(found: object) -> str:
    if not isinstance(found, Finding):
        return "picture"
    shown = {"text": found.text, "remedy": found.remedy, "data": dict(found.data)}
    json.dumps(shown, allow_nan=False).encode()
    return found.code


_YEARS = ("0000", "0001", "1899", "1900", "1970", "2025", "2199", "2200", "9999", "99999999999")
_SHAPES = (
    *(
        "image-{y}{m}{d}{H}{M}{S}.jpg",
        "{y}{m}{d}_{H}{M}{S}.jpg",
        "{y}-{m}-{d}T{H}:{M}:{S}Z.jpg",
        "{y}{m}{d}{H}{M}{S}_11.jpg",
    ),
    *("sgpC1.a1.{y}{m}{d}.{H}{M}{S}.jpg", "FF_X_{y}{m}{d}_{H}{M}{S}_123_4.fits", "ccd1_{y}{m}{d}_{H}{M}{S}.jpg"),
    *("{d}-{m}-{y} {H}.{M}.{S}.jpg", "a{y}-{m}-{d} {H}h{M}m{S}.999999.jpg", "{y}{m}{d}{H}{M}{S}.png"),
)


def name(draw: random.Random) -> str:
    """Return a file's name with a date that may be none."""
    two = [f"{draw.choice((0, 1, 12, 13, 23, 24, 28, 31, 59, 60, 99)):02d}" for _ in range(5)]
    parts = dict(zip("mdHMS", two, strict=True))
    found = draw.choice(_SHAPES).format(y=draw.choice(_YEARS), **parts)
    at = draw.randrange(len(found))
    odd = draw.choice(("", "", "", "\u00b2", "\u0663", "-", "\n", "\udcff"))
    return found if not odd else found[:at] + odd + found[at:]


def read_names(count: int, seed: int) -> Counter[str]:
    """Read the times in so many names of pictures, with and without EXIF; return how often each code came."""
    draw, codes = random.Random(seed), Counter[str]()
    offsets = [None, timedelta(0), timedelta(hours=23), timedelta(hours=-23)]
    rules = [TimeRules(offset=one) for one in offsets] + [TimeRules(pattern="image-%Y%m%d%H%M%S")]
    with TemporaryDirectory() as folder:
        source = Folder(folder)
        for _ in range(count):
            given = name(draw)
            if find_kind(given) is None:
                codes["no image"] += 1
                continue
            path = Path(folder) / given
            path.write_bytes(_dated(draw))
            try:
                frame = timed_frames(source, name_text(given), draw.choice(rules), names=set())[0]
            except FindingError as error:
                codes[_code(error.finding)] += 1
            else:
                solar_date(frame.time.timestamp(), longitude=180.0)
                codes["dated" if 1900 <= frame.time.year < 2200 else "out of range"] += 1
            path.unlink()
    return codes


def _dated(draw: random.Random) -> bytes:
    """Return the head of a picture whose header states a time that may be none."""
    date = f"{draw.choice(_YEARS[:9])}-{draw.choice(('01', '99'))}-01"
    zone = draw.choice(("GMT+14", "GMT-99", "GMT", ""))
    return PICTURES[0] if draw.random() < 0.5 else f"PRD=MOBOTIX\nDAT={date}\nTIM=23:59:59\nTZN={zone}\n".encode()


def main() -> None:
    """Print the codes of so many answers and names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    for title, codes in (("answers", ask(given.count, given.seed)), ("names", read_names(given.count, given.seed))):
        print(title, dict(codes.most_common()))


if __name__ == "__main__":
    main()
