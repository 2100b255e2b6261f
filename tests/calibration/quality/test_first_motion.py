"""What the first sightings say against a site, held against its definition written out, over random tracks."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sunarc.calibration.quality.first_motion import site_contradiction
from sunarc.common.array_types import FloatArray
from sunarc.common.findings import Finding
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions


def wrapped(degrees: float) -> float:
    return (degrees + 180.0) % 360.0 - 180.0


def contradiction_by_definition(
    unix_s: FloatArray, pixels: FloatArray, site: Site, size: tuple[int, int], mirrored: str
) -> tuple[str, dict[str, float]] | None:
    """Return what speaks against a site: the sun's motion on the sensor beside its motion over the site."""
    zenith = float(np.median(sun_angles(unix_s, site).apparent_zenith))
    if unix_s.size >= 4 and zenith > 91.0:
        return "sun_seen_below_horizon", {"n": unix_s.size, "zenith_deg": zenith}
    lasts = float(np.ptp(unix_s))
    if unix_s.size < 4 or lasts < 60.0:
        return None
    pairs = [(i, j) for i, j in combinations(range(unix_s.size), 2) if abs(unix_s[j] - unix_s[i]) > 0.2 * lasts]
    velocity = np.median([(pixels[j] - pixels[i]) / (unix_s[j] - unix_s[i]) for i, j in pairs], axis=0)
    at = float(np.median(unix_s))
    there = np.array([place - (s - at) * velocity for s, place in zip(unix_s, pixels, strict=True)])
    middle = np.median(there, axis=0)
    scatter = 1.4826 * float(np.median([math.dist(one, middle) for one in there]))
    speed = math.hypot(*velocity)
    if speed * lasts <= 8.0 * max(scatter, 0.25):
        return None
    minute = np.array([at - 30.0, at + 30.0])
    angles, (before, after) = sun_angles(minute, site), sun_directions(minute, site)
    px_per_rad = speed * 60.0 / math.acos(float(before @ after) / math.hypot(*before) / math.hypot(*after))
    off_axis = middle - [(size[0] - 1) / 2.0, (size[1] - 1) / 2.0]
    radius = math.hypot(*off_axis)
    doubt = (math.sin(math.radians(15.0)) * px_per_rad + 0.05 * max(size)) / radius
    if doubt >= 0.9:
        return None
    first, last = np.radians(angles.apparent_zenith).tolist()
    due = 0.5 * (first + last)
    around = math.sin(due) * math.radians(wrapped(float(angles.azimuth[1] - angles.azimuth[0])))
    scales = [max(math.cos(due), 0.0) + (1.0 - max(math.cos(due), 0.0)) * k / 4.0 for k in range(5)]
    ways = [math.degrees(math.atan2(around, scale * (last - first))) for scale in scales]
    outwards = off_axis / radius
    seen = []
    for hand in {"no": (1.0,), "yes": (-1.0,), "auto": (1.0, -1.0)}[mirrored]:
        across = hand * (velocity[0] * outwards[1] - velocity[1] * outwards[0])
        seen.append(math.degrees(math.atan2(across, float(velocity @ outwards))))
    off = min(abs(wrapped(one - way)) for one in seen for way in ways)
    limit = math.degrees(math.asin(doubt)) + 25.0
    shown, stated = math.degrees(radius / px_per_rad), math.degrees(due)
    lowest = due + math.radians(15.0)
    compressed = math.degrees(math.tan(lowest)) if lowest < 0.5 * math.pi else math.inf
    if off <= limit and stated - 50.0 <= shown <= max(stated + 50.0, compressed):
        return None
    numbers = {"off_deg": off, "limit_deg": limit, "seen_zenith_deg": shown, "zenith_deg": stated}
    words = [1.0 if math.cos(math.radians(way)) > 0.0 else 0.0 for way in (seen[0], ways[-1])]
    return "sun_contradicts_site", {**numbers, "seen": words[0], "expected": words[1]}


def said(found: Finding | None) -> tuple[str, dict[str, float]] | None:
    if found is None:
        return None
    words = {"sets": 1.0, "rises": 0.0}
    return found.code, {k: words[v] if isinstance(v, str) else float(v) for k, v in found.data.items()}


def test_first_sightings_contradict_a_site_where_their_motion_is_not_the_sun_s() -> None:
    """Equidistant, orthographic and stereographic cameras, tilted, mirrored or not, at sites that are stated or not."""
    rng, codes = np.random.default_rng(11), []
    for k in range(160):
        site = Site(latitude=rng.uniform(-60.0, 60.0), longitude=rng.uniform(-180.0, 180.0))
        noon = 1_368_403_200.0 + 43_200.0 - 240.0 * site.longitude
        count = int(rng.integers(3, 15))
        steps = rng.uniform(5.0, 40.0) if k % 8 == 0 else rng.uniform(20.0, 240.0)
        unix_s = np.sort(
            noon + rng.uniform(-17_000.0, 16_000.0) + steps * (np.arange(count) + rng.uniform(0, 0.5, count))
        )
        turn = Rotation.from_euler("ZYX", [rng.uniform(-180.0, 180.0), *rng.normal(0.0, 6.0, 2)], degrees=True)
        x, y, z = turn.apply(sun_directions(unix_s, site)).T
        angle = np.arctan2(np.hypot(x, y), z)
        radius = rng.uniform(150.0, 700.0) * [angle, np.sin(angle), 2.0 * np.tan(0.5 * angle)][k % 3]
        # x right, y down as one looks up: north on top has the east at the left
        pixels = np.array([700.0, 500.0]) - (radius / np.hypot(x, y))[:, None] * np.stack([x, y], axis=-1)
        pixels += rng.normal(0.0, 0.3, pixels.shape)
        pixels[rng.random(count) < 0.1] += 50.0
        if k % 5 == 0:
            pixels[:, 0] = 1399.0 - pixels[:, 0]
        stated = [
            site,
            replace(site, longitude=-site.longitude),
            replace(site, latitude=-site.latitude),
            replace(site, longitude=wrapped(site.longitude + rng.uniform(-90.0, 90.0))),
        ][int(rng.integers(4))]
        hand = ("no", "yes", "auto")[int(rng.integers(3))]
        found = said(site_contradiction(unix_s, pixels, site=stated, image_size=(1400, 1001), mirrored=hand))  # type: ignore[arg-type]
        expected = contradiction_by_definition(unix_s, pixels, stated, (1400, 1001), hand)
        assert (found is None) == (expected is None)
        codes.append("" if found is None else found[0])
        if found is not None and expected is not None:
            assert found[0] == expected[0]
            assert found[1] == pytest.approx(expected[1], rel=1e-6, abs=1e-6)
    assert min(codes.count(one) for one in ("", "sun_contradicts_site", "sun_seen_below_horizon")) >= 20
