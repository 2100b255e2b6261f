"""Many clients at once against a running service: errors, latencies, and what becomes of the capture cadence.

    .venv/bin/python docs/studies/api_load.py http://127.0.0.1:8080/ --clients 64 --seconds 60

Each client keeps one connection and asks again half a second after its answer (`--pause 0`: at once, which shows what
the service can do at most). A third of the requests each is a pixel back-projected, the status, and the current
calibration; one more client asks /healthz all the while, and /metrics tells the jitter of the capture cycles before and
under the load. The load steps back behind the service, as if it came from another machine.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import re
import urllib.request
from collections import Counter
from urllib.parse import urlsplit

import numpy as np

PIXEL = b'{"pixels": [[871.96, 700.0]]}'
QUESTIONS = (
    ("POST", "/v1/back-project", PIXEL),
    ("GET", "/v1/status", b""),
    ("GET", "/v1/calibration", b""),
)
HEALTH = (("GET", "/healthz", b""),)
HEALTH_PAUSE_S = 0.05
JITTER = re.compile(r"^sunarc_capture_jitter_seconds (\S+)$", re.MULTILINE)


def main() -> None:
    """Load the service and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("url")
    parser.add_argument("--clients", type=int, default=64)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--pause", type=float, default=0.5, help="seconds from an answer to a client's next question")
    options = parser.parse_args()
    os.nice(5)
    asyncio.run(measure(options))


async def measure(options: argparse.Namespace) -> None:
    """Ask for the time that the options say, and print the answers' latencies."""
    before = await jitters(options.url, options.seconds / 2)
    end = asyncio.get_running_loop().time() + options.seconds
    (*load, health), under = await asyncio.gather(
        asyncio.gather(
            *(client(options.url, QUESTIONS, end, options.pause) for _ in range(options.clients)),
            client(options.url, HEALTH, end, HEALTH_PAUSE_S),
        ),
        jitters(options.url, options.seconds),
    )
    latencies = [value for answered, _ in load for value in answered]
    statuses = sum((counted for _, counted in load), Counter[str]())
    rate = len(latencies) / options.seconds
    print(f"{options.clients} clients, {options.seconds:g} s: {rate:.0f} requests/s, {dict(statuses)}")
    print(f"a request: {told(latencies)}")
    print(f"/healthz beside them: {told(health[0])}; {dict(health[1])}")
    print(f"capture jitter before: {told(before)}; under load: {told(under)}")


def told(seconds: list[float]) -> str:
    """Return median, p99 and maximum in ms."""
    if not seconds:
        return "none"
    p50, p99, most = 1e3 * np.percentile(seconds, [50, 99, 100])
    return f"p50 {p50:.1f} ms, p99 {p99:.1f} ms, max {most:.1f} ms of {len(seconds)}"


async def client(
    url: str, questions: tuple[tuple[str, str, bytes], ...], end: float, pause_s: float
) -> tuple[list[float], Counter[str]]:
    """Ask again and again on one connection; return the latencies and how often each status came."""
    place = urlsplit(url)
    loop = asyncio.get_running_loop()
    latencies: list[float] = []
    statuses = Counter[str]()
    await asyncio.sleep(pause_s * np.random.default_rng().random())  # they do not begin together
    reader, writer = await asyncio.open_connection(place.hostname, place.port)
    asked = 0
    while loop.time() < end:
        method, path, body = questions[asked % len(questions)]
        head = f"{method} {path} HTTP/1.1\r\nhost: {place.netloc}\r\ncontent-type: application/json\r\n"
        head += f"content-length: {len(body)}\r\n\r\n"
        start = loop.time()
        writer.write(head.encode() + body)
        answer = await reader.readuntil(b"\r\n\r\n")
        length = re.search(rb"content-length: (\d+)", answer, re.IGNORECASE)
        await reader.readexactly(int(length[1]) if length else 0)
        latencies.append(loop.time() - start)
        statuses[answer[9:12].decode()] += 1
        asked += 1
        await asyncio.sleep(pause_s)
    writer.close()
    return latencies, statuses


async def jitters(url: str, seconds: float) -> list[float]:
    """Return the jitters of the capture cycles that /metrics tells within a time."""
    found: list[float] = []
    loop = asyncio.get_running_loop()
    end = loop.time() + seconds
    while loop.time() < end:
        text = await asyncio.to_thread(metrics, url)
        known = JITTER.search(text)
        if known and float(known[1]) not in found:
            found.append(float(known[1]))
        await asyncio.sleep(0.2)
    return found


def metrics(url: str) -> str:
    """Return what /metrics tells."""
    with urllib.request.urlopen(f"{url}metrics", timeout=10) as answer:  # noqa: S310 - the service's own address
        return str(answer.read().decode())


if __name__ == "__main__":
    main()
