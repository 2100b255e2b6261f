"""Error of suns over their stated sigma, behind and beside the edges of drawn clouds.

    python docs/studies/cloud_edges.py --images 600

Sky, lens and clouds are drawn by formulas of their own: nothing of the detector or of the simulator is used.
"""

from __future__ import annotations

import argparse
import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.detection.values import Expectation
from sunarc.sources.detect_files import detect_in_image
from sunarc.sources.expected_sun import as_predicted

SIZE = 480
CLASSES = ((0.97, 1.01, "clear"), (0.9, 0.97, "0.9 to 0.97"), (0.5, 0.9, "0.5 to 0.9"), (0.2, 0.5, "0.2 to 0.5"))
FloatArray = NDArray[np.float32]


class Drawn(NamedTuple):
    """An image, (rows, columns, 3), the sun's place in it, px, its zenith angle, rad, and its transmission."""

    image: NDArray[np.uint8]
    x: float
    y: float
    zenith: float
    through: float


def forward(cosine: FloatArray, g: float) -> FloatArray:
    """Return the light scattered forward by haze or cloud (Henyey and Greenstein), 1 at 30 degrees."""
    peak = 1.0 + g * g
    phase = (peak - 2.0 * g * cosine) ** -1.5
    return np.asarray(phase / (peak - 2.0 * g * math.cos(math.radians(30.0))) ** -1.5, dtype=np.float32)


def cloud(rng: np.random.Generator, sun: tuple[float, float], through: float, *, soft: bool) -> FloatArray:
    """Return the transmission of a cloud with a wavy edge, as much as stated at the sun, (rows, columns)."""
    rows, columns = np.mgrid[:SIZE, :SIZE].astype(np.float32)
    turn, width = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(12.0, 50.0) if soft else rng.uniform(1.0, 5.0)
    across = (columns - sun[0]) * math.cos(turn) + (rows - sun[1]) * math.sin(turn)
    along = (rows - sun[1]) * math.cos(turn) - (columns - sun[0]) * math.sin(turn)
    for length in (25.0, 70.0, 180.0):
        across += rng.normal(0.0, 0.05) * length * np.sin(2.0 * math.pi * along / length + rng.uniform(0.0, 6.3))
    depth = rng.uniform(0.3, 4.0) if through > 0.97 else max(rng.uniform(0.3, 4.0), -1.3 * math.log(through))
    small = rng.standard_normal((SIZE // 8, SIZE // 8)).astype(np.float32)
    texture = cv2.resize(cv2.GaussianBlur(small, (0, 0), 1.2), (SIZE, SIZE), interpolation=cv2.INTER_CUBIC)
    thick = depth * (1.0 + rng.uniform(0.0, 0.4) * texture).clip(0.2)
    at = min(max(-math.log(through) / float(thick[round(sun[1]), round(sun[0])]), 1e-3), 0.98)
    at_sun = width * math.log(at / (1.0 - at)) - (rng.uniform(0.0, 60.0) if through > 0.97 else 0.0)
    here = float(across[round(sun[1]), round(sun[0])])
    return np.asarray(np.exp(-thick / (1.0 + np.exp(-np.clip((across - here + at_sun) / width, -60, 60)))), np.float32)


def draw(rng: np.random.Generator, through: float, *, soft: bool, near: bool) -> Drawn:
    """Return an image of the sun behind or beside a cloud; `near` is false of one without clouds."""
    zenith, azimuth = math.radians(rng.uniform(15.0, 65.0)), rng.uniform(0.0, 2.0 * math.pi)
    middle, scale = (SIZE - 1) / 2.0, 0.47 * SIZE / (math.pi / 2.0)
    x, y = middle + scale * zenith * math.sin(azimuth), middle - scale * zenith * math.cos(azimuth)
    rows, columns = np.mgrid[:SIZE, :SIZE].astype(np.float32)
    far = np.hypot(columns - middle, rows - middle) / scale
    around = np.arctan2(columns - middle, middle - rows)
    cosine = np.clip(np.cos(far) * math.cos(zenith) + np.sin(far) * math.sin(zenith) * np.cos(around - azimuth), -1, 1)
    passes = cloud(rng, (x, y), through, soft=soft) if near else np.ones((SIZE, SIZE), np.float32)
    disc = np.arccos(cosine) < math.radians(0.27)
    at_sun = float(passes[round(y), round(x)])
    haze = rng.uniform(0.02, 0.12) * forward(cosine, 0.75) + rng.uniform(0.002, 0.01) * forward(cosine, 0.95)
    lit = rng.uniform(0.05, 0.25) * forward(cosine, 0.85) + rng.uniform(0.002, 0.02) * forward(cosine, 0.97)
    rho = np.hypot(columns - x, rows - y)
    glare = at_sun * rng.uniform(4.0, 12.0) / (1.0 + (rho / rng.uniform(2.0, 4.5)) ** 2) ** rng.uniform(0.8, 1.1)
    white = (1.0 - passes) * (rng.uniform(0.1, 0.3) + lit * np.sqrt(passes)) + passes * haze + glare
    light = np.stack([white + passes * 0.12 * blue * (1.0 + far**2 / 3.0) for blue in (1.6, 1.0, 0.6)], axis=-1)
    light = cv2.GaussianBlur((light + 300.0 * (disc * passes)[..., None]).astype(np.float32), (0, 0), 0.8)
    light[far > math.pi / 2.0] = 0.0
    tone = np.clip(rng.uniform(0.7, 1.3) * light, 0.0, 1.0) ** (1.0 / rng.uniform(1.6, 2.4))
    noisy = 255.0 * tone + rng.uniform(0.3, 1.5) * rng.standard_normal(tone.shape, dtype=np.float32) * (tone < 1.0)
    quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(80, 96))]
    packed = cv2.imencode(".jpg", np.clip(noisy, 0, 255).astype(np.uint8), quality)[1]
    return Drawn(np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), np.uint8), x, y, zenith, at_sun)


def main() -> None:
    """Print for each class of transmission and edge how many suns are accepted, their errors and what is stated."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=int, default=600)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    found: dict[str, list[tuple[float, float]]] = {}
    drawn: dict[str, int] = {}
    for number in range(given.images):
        lowest, highest, name = CLASSES[number // 2 % len(CLASSES)]
        soft, near = number % 2 == 0, number % 16 > 1
        one = draw(rng, min(rng.uniform(lowest, highest), 1.0), soft=soft, near=near)
        title = f"{name}, {('soft' if soft else 'hard') if near else 'no cloud'}"
        drawn[title] = drawn.get(title, 0) + 1
        place = Expectation(
            x_px=one.x + rng.normal(0, 0.7), y_px=one.y + rng.normal(0, 0.7), uncertainty_px=1.0,
            apparent_zenith=one.zenith,
        )  # fmt: skip
        seen = detect_in_image(one.image)
        seen = seen if seen.accepted else as_predicted(detect_in_image(one.image, expectation=place), place)
        if seen.accepted and seen.x_px is not None and seen.y_px is not None and seen.sigma_px is not None:
            found.setdefault(title, []).append((math.hypot(seen.x_px - one.x, seen.y_px - one.y), seen.sigma_px))
    for title in sorted(drawn):
        error, sigma = np.array(found.get(title, [])).reshape(-1, 2).T
        print(f"{title:22s} drawn {drawn[title]:4d} accepted {error.size:4d}", end=" ")
        if error.size:
            z = error / sigma
            rms_z, rms = (float(np.sqrt(np.mean(v**2) / 2.0)) for v in (z, error))
            print(f"rms {rms:5.2f} px, stated {np.median(sigma):4.2f}, over sigma {rms_z:4.2f}, most {z.max():4.1f}")
        else:
            print()


if __name__ == "__main__":
    main()
