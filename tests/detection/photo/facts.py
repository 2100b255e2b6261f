"""Stand-ins for real photographs, rendered from what real ones showed (docs/studies.md, "Photographs").

    python -m tests.detection.photo.facts --images 40 --sunless 2000

renders so many suns of each kind, and so many frames without one, and prints the error against the stated sigma.
"""

from __future__ import annotations

import argparse
import math
import sys
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from tests.detection.rendering import FloatArray

from sunarc.detection.photo.ordinary_image import Photo, detect_sun_in_photo
from sunarc.detection.values import Expectation

Picture = NDArray[np.uint8]


class Facts(NamedTuple):
    """What the images of a series have in common.

    radius : range of the rim's radius over the image's smaller side. level : at which the sun is clipped, of 255. rim :
    light at 1.1 and 1.3 radii over that level. near, far, wide : at 1.7, 2.6 and 5 radii. uneven : range of the width
    of the light at 1.7 radii over its fall. slope : of the sky across the image, levels. quality : of the JPEG.
    mark_px, streaks, text : a black-sun mark within the plateau, streaks of the lens through it, and an overlay of 255.
    edge : radii by which the light has fallen to `near`. drawn_out : the longer axis over the shorter, less 1, at most.
    cloud : range of the standard deviation of the logarithm of the transmission of cloud before the sun and its glare.
    covered : range of the transmission of a cloud whose edge passes through the sun's rim; none where both are 1.
    size : the smaller side of the real images, px.
    """

    radius: tuple[float, float]
    level: int = 255
    rim: tuple[float, float] = (0.968, 0.947)
    near: float = 0.888
    far: float = 0.795
    wide: float = 0.653
    uneven: tuple[float, float] = (0.2, 0.8)
    slope: float = 0.1
    quality: int = 92
    mark_px: int = 0
    streaks: int = 0
    text: bool = True
    edge: float = 1.7
    drawn_out: float = 0.0
    cloud: tuple[float, float] = (0.0, 0.0)
    covered: tuple[float, float] = (1.0, 1.0)
    size: int = 1920


KINDS = {
    "clear, saturated": Facts((0.032, 0.05), uneven=(0.24, 0.9), slope=0.15),
    "haze": Facts(
        (0.012, 0.033),
        rim=(0.939, 0.891),
        near=0.838,
        far=0.743,
        wide=0.651,
        uneven=(0.05, 0.15),
        mark_px=3,
        cloud=(0.007, 0.015),
    ),
    "thin cloud": Facts(
        (0.04, 0.06), rim=(0.951, 0.913), near=0.853, far=0.76, wide=0.572, uneven=(0.1, 0.3), cloud=(0.05, 0.1)
    ),
    "HDR, Raspberry Pi": Facts(
        (0.007, 0.018),
        rim=(0.95, 0.895),
        near=0.808,
        far=0.712,
        wide=0.541,
        uneven=(0.21, 0.89),
        streaks=1,
        text=False,
        size=840,
    ),
    "clipped at 160": Facts((0.015, 0.03), level=160, uneven=(0.2, 0.6)),
    "short exposure": Facts(
        (0.028, 0.049),
        level=160,
        near=0.48,
        far=0.44,
        wide=0.34,
        uneven=(0.04, 0.14),
        edge=1.25,
        drawn_out=0.4,
        cloud=(0.03, 0.1),
        covered=(0.6, 0.9),
        size=960,
    ),
    "poor JPEG": Facts((0.02, 0.04), uneven=(0.2, 0.6), quality=70),
}
SUNLESS = ("overcast", "bright cloud", "roofs and text", "lamp at night", "moonlit night", "blank", "contrails")

_TEXTURES = ((3.5, 1.3), (0.2, 0.8))
"""Widths of the unevenness, radii, and the share of each in its standard deviation: by harmonics of the light about the
real suns (docs/studies.md, "Stand-ins")."""
_CLOUD_TEXTURES = ((2.0, 0.6), (0.5, 0.8))
"""The same of the logarithm of the transmission of cloud: beside the sun in thin cloud the first, the second and the
third to sixth harmonics are alike, and at 1.1 radii half of what they are at 1.7 (0.03 and 0.06)."""
_UNEVEN_OF_UNIT = 1.9
"""Width of the middle 70 % of a normal distribution's light at 1.7 radii, in its standard deviations."""


def sun_photo(
    facts: Facts, rng: np.random.Generator, *, size: int = 480, place: tuple[float, float] | None = None
) -> tuple[Picture, tuple[float, float]]:
    """Return an image, (size, size, 3), and the place of its sun: the one asked for, or any."""
    angle, apart = rng.uniform(0.0, 2.0 * math.pi), 0.35 * size * math.sqrt(rng.uniform(0.0, 1.0))
    x, y = place or (0.5 * size + apart * math.cos(angle), 0.5 * size + apart * math.sin(angle))
    radius = max(size * rng.uniform(*facts.radius), 2.5)
    rows, columns = np.mgrid[:size, :size].astype(np.float64)
    far = _distance(columns - x, rows - y, facts, rng) / radius
    light = np.interp(far, *_profile(facts))
    # The unevenness grows with the fall of the light: at 1.3 and at 1.7 radii real ones have the same share of it.
    amount = rng.uniform(*facts.uneven) * (1.0 - facts.near) / _UNEVEN_OF_UNIT
    # By parts of the way around, as on real ones: the wide one moves the rim, the fine one scatters it.
    parts = [share * _texture(rng, size, max(width * radius, 1.0)) for width, share in _TEXTURES]
    light += amount * np.clip((1.0 - light) / (1.0 - facts.near), 0.0, 2.0) * sum(parts)
    light += facts.slope * 0.3 * (rows - y) / size
    cloud = sum(share * _texture(rng, size, max(width * radius, 1.0)) for width, share in _CLOUD_TEXTURES)
    light *= np.exp(rng.uniform(*facts.cloud) * cloud)  # before the light is clipped
    if facts.covered[0] < 1.0:
        light *= _cloud_edge((columns - x) / radius, (rows - y) / radius, facts, rng)
    for _ in range(facts.streaks):
        ray = rng.uniform(0.0, math.pi)
        across = np.abs((columns - x) * math.sin(ray) - (rows - y) * math.cos(ray))
        light += 0.15 * np.exp(-0.5 * (across / (0.15 * radius + 1.0)) ** 2)
    light[np.hypot(columns - 0.5 * size, rows - 0.5 * size) > 0.49 * size] = 0.03
    image = _colours(light, facts.level, rng)
    if facts.mark_px:
        row, column = round(y), round(x - 0.3 * radius)
        image[row : row + facts.mark_px, column : column + facts.mark_px] = (40, 150, 235)
    return _compressed(_with_text(image) if facts.text else image, facts.quality), (x, y)


def _profile(facts: Facts) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the light over the radius, in radii of the rim."""
    glare = (facts.near, facts.far, facts.wide, min(0.36, 0.85 * facts.wide), min(0.25, 0.7 * facts.wide))
    beyond = (1.7, 2.6, 5.0, 15.0, 60.0)
    if facts.edge < 1.7:
        return (0.0, 1.0, facts.edge, *beyond), (1.6, 1.0, facts.near, *glare)
    return (0.0, 0.8, 0.9, 1.0, 1.1, 1.3, *beyond), (1.6, 1.0, 0.99, 0.974, *facts.rim, *glare)


def _cloud_edge(dx: FloatArray, dy: FloatArray, facts: Facts, rng: np.random.Generator) -> FloatArray:
    """Return the transmission of a cloud whose edge passes at 0.6 to 1.5 radii from the sun; dx, dy in radii."""
    ray, wide = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.1, 0.5)
    beyond = dx * math.cos(ray) + dy * math.sin(ray) - rng.uniform(0.6, 1.5)
    return np.asarray(1.0 - (1.0 - rng.uniform(*facts.covered)) / (1.0 + np.exp(-beyond / wide)))


def _distance(dx: FloatArray, dy: FloatArray, facts: Facts, rng: np.random.Generator) -> FloatArray:
    """Return the distance from the sun, drawn out in some direction."""
    if not facts.drawn_out:
        return np.asarray(np.hypot(dx, dy))
    ray, longer = rng.uniform(0.0, math.pi), math.sqrt(1.0 + rng.uniform(0.0, facts.drawn_out))
    along, across = dx * math.cos(ray) + dy * math.sin(ray), dy * math.cos(ray) - dx * math.sin(ray)
    return np.asarray(np.hypot(along / longer, across * longer))


def sunless_photo(kind: str, rng: np.random.Generator, *, size: int = 320) -> Picture:
    """Return an image without a sun, (size, size, 3)."""
    rows, columns = np.mgrid[:size, :size].astype(np.float64)
    light = np.full((size, size), rng.uniform(0.3, 0.9))
    if kind in {"overcast", "bright cloud"}:
        coarse, fine = (_texture(rng, size, size * rng.uniform(*span)) for span in ((0.08, 0.3), (0.01, 0.06)))
        light += (0.12 if kind == "overcast" else 0.35) * (coarse + rng.uniform(0.1, 0.5) * fine)
    elif kind == "roofs and text":
        for _ in range(rng.integers(1, 6)):
            top, left, high, wide = (int(v) for v in rng.uniform((0, 0, 5, 5), (size, size, 60, 60)))
            light[top : top + high, left : left + wide] = rng.uniform(0.9, 1.5)
    elif kind in {"lamp at night", "moonlit night"}:
        light[:] = rng.uniform(0.02, 0.1)
        x, y, radius = rng.uniform(30, size - 30), rng.uniform(30, size - 30), rng.uniform(3.0, 15.0)
        far = np.hypot(columns - x, rows - y) / radius
        halo = rng.uniform(0.1, 0.6) if kind == "lamp at night" else rng.uniform(0.2, 0.5)
        light += np.where(far < 1.0, 1.2, halo / np.maximum(far, 1.0) ** rng.uniform(1.0, 2.5))
    elif kind == "contrails":
        for _ in range(rng.integers(1, 7)):
            ray, at = rng.uniform(0.0, math.pi), rng.uniform(-0.3, 0.3) * size
            across = (columns - size / 2) * math.sin(ray) - (rows - size / 2) * math.cos(ray) - at
            light += rng.uniform(0.2, 0.9) * np.exp(-0.5 * (across / rng.uniform(2.0, 12.0)) ** 2)
    light[np.hypot(columns - 0.5 * size, rows - 0.5 * size) > 0.49 * size] = 0.03
    return _compressed(_with_text(_colours(light, 255, rng)), int(rng.integers(50, 95)))


def _texture(rng: np.random.Generator, size: int, scale_px: float) -> FloatArray:
    """Return a random field of unit variance and a correlation length, (size, size)."""
    cells = max(3, math.ceil(size / scale_px) + 3)
    coarse = rng.standard_normal((cells, cells)).astype(np.float32)
    wide = cv2.resize(coarse, None, fx=scale_px, fy=scale_px, interpolation=cv2.INTER_CUBIC)
    part = np.asarray(wide[:size, :size], dtype=np.float64)
    return np.asarray((part - part.mean()) / max(float(part.std()), 1e-6))


def _colours(light: FloatArray, level: int, rng: np.random.Generator) -> Picture:
    """Return three colours of a light, clipped: the faintest is the light itself."""
    gains = rng.permutation([1.0, rng.uniform(1.0, 1.15), rng.uniform(1.05, 1.3)])
    noisy = light[..., None] * gains + rng.normal(0.0, 0.006, (*light.shape, 3))
    return np.asarray(np.round(level * np.clip(noisy, 0.0, 1.0)), dtype=np.uint8)


def _with_text(image: Picture) -> Picture:
    drawn = image.copy()
    for place in ((3, 12), (3, image.shape[0] - 4)):
        cv2.putText(drawn, "2016-05-30 09:44 UTC+1", place, cv2.FONT_HERSHEY_SIMPLEX, 0.35, (255, 255, 255), 1)
    return drawn


def _compressed(image: Picture, quality: int) -> Picture:
    done, packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert done
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), dtype=np.uint8)


class Outcome(NamedTuple):
    """Of the images of a kind: how many there were, and error and sigma of the accepted suns, px."""

    images: int
    error_px: FloatArray
    sigma_px: FloatArray

    @property
    def chi2(self) -> float:
        """Mean squared error per axis over the variance."""
        return float(np.mean((self.error_px / self.sigma_px) ** 2)) / 2.0


def outcome_of(kind: str, images: int, rng: np.random.Generator, *, size: int | None = None) -> Outcome:
    """Return what became of so many suns of a kind, in images of the size of the real ones if none is given."""
    error, sigma = list[float](), list[float]()
    for _ in range(images):
        image, place = sun_photo(KINDS[kind], rng, size=size or KINDS[kind].size)
        found = detect_sun_in_photo(Photo(image, 255))
        if found.accepted and found.x_px is not None and found.y_px is not None and found.sigma_px is not None:
            error.append(math.hypot(found.x_px - place[0], found.y_px - place[1]))
            sigma.append(found.sigma_px)
    return Outcome(images, np.array(error), np.array(sigma))


def accepted_without_a_sun(kind: str, images: int, rng: np.random.Generator, *, size: int = 320) -> tuple[int, int]:
    """Return how many of so many frames without a sun were accepted without and with a prediction of its place."""
    alone = predicted = 0
    for _ in range(images):
        image = sunless_photo(kind, rng, size=size)
        angle, apart = rng.uniform(0.0, 2.0 * math.pi), 0.45 * size * math.sqrt(rng.uniform(0.0, 1.0))
        x, y = (0.5 * size + apart * math.cos(angle), 0.5 * size + apart * math.sin(angle))
        expected = Expectation(x_px=x, y_px=y, uncertainty_px=2.0)
        alone += detect_sun_in_photo(Photo(image, 255)).accepted
        predicted += detect_sun_in_photo(Photo(image, 255), expectation=expected).accepted
    return alone, predicted


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=int, default=40)
    parser.add_argument("--sunless", type=int, default=700)
    parser.add_argument("--size", type=int, help="smaller side of the images, px; that of the real ones by default")
    arguments, rng = parser.parse_args(), np.random.default_rng(16)
    for kind in KINDS:
        found = outcome_of(kind, arguments.images, rng, size=arguments.size)
        far = np.count_nonzero(found.error_px > 4.0 * found.sigma_px)
        sys.stdout.write(
            f"| {kind} | {len(found.error_px)} of {found.images} | {np.median(found.error_px):.2f} | "
            f"{np.median(found.sigma_px):.2f} | {found.chi2:.2f} | {far} |\n"
        )
        sys.stdout.flush()
    for index, kind in enumerate(SUNLESS):
        count = len(range(index, arguments.sunless, len(SUNLESS)))
        alone, predicted = accepted_without_a_sun(kind, count, rng)
        sys.stdout.write(f"| {kind} | {alone} of {count} accepted, {predicted} with a prediction |\n")


if __name__ == "__main__":
    main()
