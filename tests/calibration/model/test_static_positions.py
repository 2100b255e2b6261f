"""Positions that stay where they are while the sun moves: found, left out, named; a slow sun keeps every sighting."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.fixtures.finding_codes import codes

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.optics.forward import project
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

if TYPE_CHECKING:
    from tests.fixtures.clear_day import Simulated, Simulator

SIZE = (1748, 1748)


def with_overlay(seen: Simulated, *places: tuple[float, float], share: float, jitter_px: float = 0.0) -> Sightings:
    """Put a share of the sightings, spread over the day, onto positions that do not move."""
    rng = np.random.default_rng(5)
    pixels, n = seen.points.pixels.copy(), len(seen.points)
    rows = rng.permutation(n)[: round(share * n)]
    for number, place in enumerate(places):
        mine = rows[number :: len(places)]
        pixels[mine] = np.array(place) + rng.uniform(-jitter_px, jitter_px, (mine.size, 2))
    return replace(seen.points, pixels=pixels)


@pytest.mark.parametrize(
    ("places", "jitter_px"),
    [(((1650.0, 30.0),), 0.0), (((1650.4, 30.6),), 0.9), (((1650.0, 30.0), (60.0, 1700.0)), 0.0)],
    ids=["one pixel", "jitter", "two overlays"],
)
def test_an_overlay_among_true_sightings_is_left_out_and_named(
    simulator: Simulator, places: tuple[tuple[float, float], ...], jitter_px: float
) -> None:
    seen = simulator(sigma_px=0.3)
    points = with_overlay(seen, *places, share=0.4, jitter_px=jitter_px)
    still = np.any(points.pixels != seen.points.pixels, axis=-1)
    usable = filter_sightings(points, site=seen.site)
    assert np.array_equal(np.sort(usable.index), np.flatnonzero(~still))
    assert len(usable.filtering.static) == len(places)
    assert sum(position.n for position in usable.filtering.static) == still.sum()
    found = calibrate(points, site=seen.site, image_size=SIZE)
    assert found.verdict.accepted, found.verdict.reasons
    assert found.left_out is not None
    assert set(np.flatnonzero(still)) <= set(found.left_out)
    assert {"dropped_static", "static_positions"} <= set(codes(found.verdict.findings))
    assert seen.track_error_px(found.camera) < 0.2


def test_a_record_that_mostly_stands_still_is_refused_with_the_place(simulator: Simulator) -> None:
    seen = simulator(sigma_px=0.3)
    points = with_overlay(seen, (1650.0, 30.0), share=0.57)
    found = calibrate(points, site=seen.site, image_size=SIZE)
    assert not found.verdict.accepted
    (reason,) = found.verdict.findings
    assert reason.code == "static_sightings"
    assert "x 1650, y 30" in str(reason.data["places"])
    assert found.evidence.n_used == 0


@pytest.mark.parametrize("latitude", [0.0, 36.6, 78.0])
@pytest.mark.parametrize("focal_px", [100.0, 600.0])
def test_whole_pixels_at_a_high_cadence_are_the_sun(simulator: Simulator, latitude: float, focal_px: float) -> None:
    site = Site(latitude=latitude, longitude=15.0)
    times = 1_466_380_800.0 + np.arange(0.0, 86_400.0, 5.0)
    times = times[sun_angles(times, site).apparent_zenith < 89.6]
    camera = replace(simulator().camera, focal_length_px=(focal_px, focal_px), radial=(0.0,) * 8)
    pixels = np.rint(project(camera, sun_directions(times, site)))
    usable = filter_sightings(Sightings.of(unix_s=times, pixels=pixels), site=site)
    assert len(usable) == times.size
    assert usable.filtering.static == ()


def test_gross_errors_at_one_place_do_not_make_the_sun_stand_still(simulator: Simulator) -> None:
    seen = simulator(sigma_px=0.3, cadence_s=10.0)
    pixels = np.rint(seen.points.pixels)
    pixels[::2000] = pixels[1500]
    usable = filter_sightings(replace(seen.points, pixels=pixels), site=seen.site)
    assert usable.filtering.static == ()
