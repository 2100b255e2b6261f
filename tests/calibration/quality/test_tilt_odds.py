"""The question to clock and site of a tilted camera, held against its definition written out, over random cameras."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.fixtures.calibration import ideal_camera

from sunarc.array_types import FloatArray
from sunarc.calibration.quality.tilt import mount_density, tilt_question
from sunarc.optics.camera import Camera
from sunarc.sky.site import Site

EAST = np.array([1.0, 0.0, 0.0])


def pole_at(latitude: float) -> FloatArray:
    return np.array([0.0, math.cos(math.radians(latitude)), math.sin(math.radians(latitude))])


def wrapped(degrees: float) -> float:
    return (degrees + 180.0) % 360.0 - 180.0


def looking(axis: FloatArray) -> Camera:
    """Return a camera whose optical axis is in a direction."""
    across = np.cross(axis, [0.0, 0.0, 1.0])
    turn = across / np.linalg.norm(across) * math.acos(axis[2])
    return replace(ideal_camera(), rotation_cam_enu=tuple(turn.tolist()))


def mounted(axis: FloatArray) -> FloatArray:
    """Return by how much mounts hold their axes in directions (..., 3), per steradian."""
    tilt = np.degrees(np.arccos(np.clip(axis[..., 2], -1.0, 1.0)))
    by_hand = np.exp(-0.5 * (tilt / 2.0) ** 2) / (2.0 * math.pi * math.radians(2.0) ** 2)
    cap = 2.0 * math.pi * (1.0 - math.cos(math.radians(75.0)))
    return 0.95 * by_hand + 0.05 * np.where(tilt <= 75.0, 1.0, 0.01) / cap


def question_by_definition(axis: FloatArray, site: Site) -> tuple[str, dict[str, float]] | None:
    """Return code and data of the likeliest mistake that would make a camera level."""
    tilt = math.degrees(math.acos(axis[2]))
    if tilt <= 5.0:
        return None
    hours = {k / 2.0: 1.0 if k % 2 == 0 else 0.1 for k in range(-28, 29) if k}
    every = sum(hours.values())
    longitudes = [(k / 2.0, 0.001 / 720.0) for k in range(-360, 360)] + [(2.0 * site.longitude, 0.005)]
    latitudes = [(k / 2.0 - site.latitude, 0.001 / 360.0) for k in range(-180, 180)] + [(-2.0 * site.latitude, 0.005)]
    mistakes = {
        "camera_tilted_by_clock": (pole_at(site.latitude), [(15.0 * h, 0.02 * w / every) for h, w in hours.items()]),
        "camera_tilted_by_longitude": (pole_at(site.latitude), longitudes),
        "camera_tilted_by_latitude": (EAST, latitudes),
    }
    best, code, turn = -1.0, "", 0.0
    for name, (about, turns) in mistakes.items():
        degrees, share = np.array(turns).T
        density = share * mounted(Rotation.from_rotvec(np.radians(degrees)[:, None] * about).apply(axis))
        if density.sum() > best:
            best, code, turn = float(density.sum()), name, float(degrees[np.argmax(density)])
    odds = best / ((1.0 - 0.02 - 2.0 * 0.006) * float(mounted(axis)))
    if odds < 0.01:
        return "camera_tilted", {"tilt_deg": tilt, "odds": 0.0}
    if code == "camera_tilted_by_latitude":
        return code, {"latitude": site.latitude + turn, "tilt_deg": tilt, "odds": odds}
    level = {"hours": turn / 15.0, "longitude": wrapped(site.longitude - turn)}
    return code, {**level, "tilt_deg": tilt, "odds": odds}


def test_the_likeliest_mistake_and_its_odds_are_those_of_the_shares_of_mounts_and_sites() -> None:
    rng, seen = np.random.default_rng(7), []
    for k in range(160):
        site = Site(latitude=rng.uniform(-65.0, 65.0), longitude=rng.uniform(-180.0, 180.0))
        lean = rng.uniform(0.0, 2.0 * math.pi)
        tilt = math.radians(rng.uniform(4.0, 80.0) if k % 2 else rng.rayleigh(2.0))
        axis = np.array([math.sin(tilt) * math.cos(lean), math.sin(tilt) * math.sin(lean), math.cos(tilt)])
        mistake = [
            15.0 * round(rng.uniform(-20.0, 20.0)) / 2.0 * pole_at(site.latitude),
            -2.0 * site.longitude * pole_at(site.latitude),
            rng.uniform(-90.0, 90.0) * pole_at(site.latitude),
            (2.0 * site.latitude if k % 3 else rng.uniform(-40.0, 40.0)) * EAST,
        ][k // 2 % 4]
        if k % 2 == 0:
            axis = Rotation.from_rotvec(np.radians(mistake)).apply(axis)
        question, expected = tilt_question(looking(axis), site), question_by_definition(axis, site)
        if expected is None:
            assert question is None
            continue
        assert question is not None
        assert question.code == expected[0]
        assert dict(question.data) == pytest.approx(expected[1], rel=1e-7, abs=1e-7)
        seen.append(question)
    codes = [one.code.rsplit("_", 1)[-1] for one in seen]
    assert min(codes.count(one) for one in ("clock", "longitude", "latitude", "tilted")) >= 8
    # the least odds that are worth a question are met from both sides
    assert any(0.01 <= float(one.data["odds"]) < 0.015 for one in seen)


def test_the_shares_of_mounts_are_those_of_levelled_and_of_tilted_ones() -> None:
    tilts = np.radians([0.0, 1.0, 3.0, 9.0, 40.0, 74.9, 75.1, 120.0])
    axes = np.stack([np.sin(tilts), np.zeros(tilts.size), np.cos(tilts)], axis=-1)
    np.testing.assert_allclose(mount_density(axes), mounted(axes), rtol=1e-9)
