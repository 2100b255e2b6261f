"""Rates at which live cameras are taken for frozen or damaged, and frozen and damaged ones are found.

    .venv/bin/python -m tests.imager.live.frozen_rates --days 1000 --seed 1

draws camera-days of pictures whose formulas stand here alone: lenses, clear and overcast skies, fog, clouds that move
in every other quarter of an hour, overexposure, a covered lens and a lamp, with and without noise, automatic exposure,
JPEG and a burnt-in clock, before a foreground that stands still; a part of each day every 30 s, the rest every 10
minutes. Printed are the alarms by kind.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from tests.imager.live.sky_pictures import ALTITUDE, LATITUDE, LONGITUDE

from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.image_faults import FrozenAlarm, RepeatedImages, TransferFaults
from sunarc.imaging.image_tiles import image_tiles
from sunarc.sky.site import Site

SIDE = 160
SITE = Site(latitude=LATITUDE, longitude=LONGITUDE, altitude=ALTITUDE)
LIVE = ("clear", "overcast", "fog", "clouds", "white", "covered", "lamp")
FAULTS = ("frozen clear", "frozen overcast", "smear", "four bits")


class Camera(NamedTuple):
    """What a camera-day is drawn from."""

    kind: str
    noise: float
    quality: int | None
    exposes: bool
    clock: bool
    seed: int


def pictures(camera: Camera) -> Iterator[tuple[datetime, NDArray[np.uint8], tuple[float, float] | None]]:
    """Yield the time, picture and sun of a camera-day; the sun goes from east to west by 15 degrees an hour."""
    rng = np.random.default_rng(camera.seed)
    rows, columns = np.mgrid[0:SIDE, 0:SIDE].astype(np.float64)
    foreground = np.where(rows + 12.0 * np.sin(columns / 17.0) > 0.72 * SIDE, rng.uniform(0.1, 0.5, rows.shape), 0.0)
    foreground = cv2.GaussianBlur(foreground, (0, 0), 0.8) * (rows > 0.68 * SIDE)
    fault_at = rng.integers(15, 30)
    still: tuple[NDArray[np.uint8], tuple[float, float] | None] | None = None
    start_h = float(rng.uniform(-4.5, 2.0))
    for n in range(80):
        hour = start_h + (n / 120.0 if n < 40 else 40 / 120.0 + (n - 39) / 6.0)
        time = datetime(2025, 5, 13, 18, 30, tzinfo=UTC) + timedelta(hours=hour)
        image, sun = _scene(camera, hour, foreground)
        values = 255.0 * image
        values = values + rng.normal(0.0, 1.0, values.shape) * camera.noise * (values < 254.5)
        shown = np.clip(np.round(values), 0, 255).astype(np.uint8)
        if camera.kind.startswith("frozen") and n >= fault_at:
            shown, sun = still if still is not None else (shown, sun)
            still = (shown, sun)
        shown = np.asarray(_damaged(camera, shown) if n >= fault_at else shown, np.uint8)
        if camera.clock:
            shown = np.asarray(cv2.rectangle(shown.copy(), (0, 0), (SIDE // 2, 10), 0, -1), np.uint8)
            text = f"{time:%H:%M:%S}"
            shown = np.asarray(cv2.putText(shown, text, (1, 9), cv2.FONT_HERSHEY_SIMPLEX, 0.35, 220, 1), np.uint8)
        if camera.quality is not None:
            coded = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, camera.quality])[1]
            shown = np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), np.uint8)
        yield time, shown, sun


def _scene(
    camera: Camera, hour: float, foreground: NDArray[np.float64]
) -> tuple[NDArray[np.float64], tuple[float, float] | None]:
    rows, columns = np.mgrid[0:SIDE, 0:SIDE].astype(np.float64)
    off = np.hypot(rows - SIDE / 2, columns - SIDE / 2) / (SIDE / 2)
    kind = camera.kind.removeprefix("frozen ")
    angle = np.radians(15.0 * hour)
    x, y = SIDE / 2 - 0.45 * SIDE * np.sin(angle), SIDE / 2 - 0.2 * SIDE * np.cos(angle)
    light = 1.0 if camera.exposes else float(np.cos(0.75 * angle))
    glare = np.hypot(columns - x, rows - y) / (SIDE / 2)
    sky, sun = np.full(rows.shape, 0.3), None
    if kind in {"clear", "smear", "four bits"}:
        sky, sun = 0.25 + 0.1 * glare + 0.9 * np.exp(-(glare - 0.04) / 0.08), (float(x), float(y))
    elif kind in {"overcast", "lamp"}:
        sky = (0.55 - 0.15 * off**2 + 0.02 * np.exp(-glare)) * light
    elif kind == "fog":
        sky = np.full(rows.shape, 0.6 * light)
    elif kind == "clouds":
        moving = np.sin(columns / 14.0 + 40.0 * hour) + np.sin(rows / 11.0 - 25.0 * hour + columns / 23.0)
        sky = 0.5 * light + 0.1 * moving * (hour % 0.5 < 0.25)
    elif kind == "white":
        sky = np.full(rows.shape, 1.2)
    elif kind == "covered":
        return np.full(rows.shape, 0.0), None
    image = np.where(foreground > 0.0, foreground * light, sky)
    if kind == "lamp":
        image = image + np.exp(-((columns - 40) ** 2 + (rows - 120) ** 2) / 18.0)
        sun = (40.0, 120.0)  # what is taken for the sun
    return np.where(off < 0.97, image, 0.0), sun


def _damaged(camera: Camera, shown: NDArray[np.uint8]) -> NDArray[np.uint8]:
    if camera.kind == "smear":
        shown = shown.copy()
        shown[SIDE // 2 :] = shown[SIDE // 2]
    return np.asarray(shown & 0xF0, np.uint8) if camera.kind == "four bits" else shown


def codes_of(camera: Camera) -> set[str]:
    """Return the conditions of a camera-day."""
    board = StatusRegistry(version="1", started_at=datetime(2025, 5, 13, tzinfo=UTC), monotonic=lambda: 0.0)
    events = SimpleNamespace(add_event=lambda *_, **__: None)
    alarm, repeated, faults = FrozenAlarm(events, board), RepeatedImages(SITE), TransferFaults(board)  # type: ignore[arg-type]
    codes = set[str]()
    for time, image, sun in pictures(camera):
        earlier = repeated.earlier(image_tiles(image), time, sun)
        faults.note(image)
        if earlier is None:
            alarm.clear()
        elif earlier.is_sure:
            alarm.note(time, earlier.time)
        codes |= {reason.code for reason in board.snapshot().reasons}
    return codes


def drawn(kind: str, rng: np.random.Generator) -> Camera:
    """Return a camera of a kind; four-bit data reaches the file without JPEG alone."""
    quality = None if kind == "four bits" else (None, 40, 75, 92)[int(rng.integers(4))]
    noise = float(rng.choice([0.0, 0.0, 0.5, 1.5, 4.0]))
    noise = max(noise, 0.5) if kind == "frozen overcast" else noise
    return Camera(kind, noise, quality, bool(rng.integers(2)), bool(rng.integers(2)), int(rng.integers(1 << 31)))


def main() -> None:
    """Print how many camera-days of each kind had which alarms."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--days", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    for kinds in (LIVE, FAULTS):
        for kind in kinds:
            found, days = Counter[str](), max(given.days // len(kinds) // (1 if kinds is LIVE else 5), 1)
            for _ in range(days):
                camera = drawn(kind, rng)
                found.update(codes := codes_of(camera))
                if kinds is LIVE and codes:
                    print("  false:", camera, codes)
            print(f"{kind}: {days} camera-days, {dict(found)}", flush=True)


if __name__ == "__main__":
    main()
