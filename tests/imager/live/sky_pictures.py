"""Pictures of the sky by a lens whose truth is known here alone: its formulas are written out, and share no code."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

import cv2
import numpy as np
import pandas as pd
import pvlib
from numpy.typing import NDArray

LATITUDE, LONGITUDE, ALTITUDE = 36.604043, -97.484856, 318.0


@dataclass(frozen=True)
class Lens:
    """An equisolid lens that looks up: focal length and centre, px; turned from north, tilted to the east, degrees."""

    size: int = 320
    focal_px: float = 108.0
    x: float = 158.3
    y: float = 161.9
    turn_deg: float = 24.0
    tilt_deg: float = 1.5

    def pixel(self, zenith_deg: float, azimuth_deg: float) -> tuple[float, float]:
        zenith, azimuth = np.radians([zenith_deg, azimuth_deg])
        east, north, up = np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)
        tilt, turn = np.radians([self.tilt_deg, self.turn_deg])
        east, up = np.cos(tilt) * east - np.sin(tilt) * up, np.sin(tilt) * east + np.cos(tilt) * up
        angle, around = np.arccos(up), np.arctan2(east, north) + turn
        radius = 2.0 * self.focal_px * np.sin(angle / 2.0)
        # seen from below: with north at the top, east is to the left
        return float(self.x - radius * np.sin(around)), float(self.y - radius * np.cos(around))


def sun_at(time: datetime) -> tuple[float, float]:
    """Return the sun's apparent zenith angle and azimuth, degrees, by pvlib."""
    found = pvlib.solarposition.get_solarposition(
        pd.DatetimeIndex([time]), LATITUDE, LONGITUDE, altitude=ALTITUDE, temperature=12.0, pressure=97_500.0
    )
    return float(found["apparent_zenith"].iloc[0]), float(found["azimuth"].iloc[0])


def picture(
    time: datetime, lens: Lens, rng: np.random.Generator, *, cloud: bool = False, plateau_deg: float = 2.6
) -> NDArray[np.uint8]:
    """Return the sky at a moment, (rows, columns, 3): a sun that saturates its glare, or cloud all over."""
    rows, columns = np.mgrid[0 : lens.size, 0 : lens.size].astype(np.float64)
    zenith_deg, azimuth_deg = sun_at(time)
    sky = np.full(rows.shape, 0.30)
    if cloud:
        blobs = cv2.GaussianBlur(rng.normal(size=rows.shape), (0, 0), 9.0)
        sky = 0.55 + 0.12 * blobs / blobs.std()
    elif zenith_deg < 90.0:
        x, y = lens.pixel(zenith_deg, azimuth_deg)
        off_deg = np.degrees(np.hypot(columns - x, rows - y) / lens.focal_px)
        sky = sky + (1.0 - 0.30) * np.exp(-(off_deg - plateau_deg) / 6.0)
    else:
        sky = np.full(rows.shape, 0.01)
    sky = np.where(np.hypot(columns - lens.x, rows - lens.y) < 1.42 * lens.focal_px, sky, 0.0)
    noisy = 255.0 * np.clip(sky, 0.0, 1.0)[..., None] * np.array([1.0, 0.98, 0.96]) ** (sky[..., None] < 1.0)
    noisy = noisy + rng.normal(0.0, 1.5, noisy.shape) * (noisy < 254.0)
    image: NDArray[np.uint8] = np.clip(np.round(noisy), 0, 255).astype(np.uint8)
    return image


def with_clock(image: NDArray[np.uint8], second: int) -> NDArray[np.uint8]:
    """Return a picture with a time of day burnt into its upper left."""
    text = f"2025-05-13 15:{second // 60:02d}:{second % 60:02d}"
    shown = cv2.rectangle(image.copy(), (0, 0), (190, 15), (0, 0, 0), -1)
    return np.asarray(cv2.putText(shown, text, (2, 12), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1))


def jpeg(image: NDArray[np.uint8]) -> bytes:
    """Return an image as a camera sends it."""
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 92])[1].tobytes()
