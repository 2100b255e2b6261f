"""A site with a wrong sign is said by its first ten sightings, and a right one never doubted."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from sunarc.calibration.quality.first_motion import site_contradiction
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.forward import project
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

EVENING = datetime(2013, 5, 13, 23, 30, tzinfo=UTC)
MORNING = datetime(2013, 5, 13, 14, 30, tzinfo=UTC)
NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
EAST = replace(SGP, longitude=-SGP.longitude)
SOUTH = replace(SGP, latitude=-SGP.latitude)
SIZE = (1748, 1748)
TRUTH = replace(true_camera(), max_angle=2.0)


def seen_from(begin: datetime) -> tuple[np.ndarray, np.ndarray]:
    times = begin.timestamp() + 30.0 * np.arange(10)
    noise = np.random.default_rng(4).normal(0.0, 0.3, (10, 2))
    return times, project(TRUTH, sun_directions(times, SGP)) + noise


@pytest.mark.parametrize(
    ("begin", "site", "code"),
    [
        (EVENING, SGP, None),
        (MORNING, SGP, None),
        (NOON, SGP, None),
        (EVENING, EAST, "sun_contradicts_site"),
        (MORNING, EAST, "sun_seen_below_horizon"),
        (NOON, EAST, "sun_seen_below_horizon"),
        (MORNING, SOUTH, "sun_contradicts_site"),
        (NOON, SOUTH, None),  # 18 degrees from the zenith: which way is outwards is in doubt
        (MORNING, replace(SGP, longitude=SGP.longitude + 15.0), None),  # an hour: without a lens nothing tells
    ],
)
def test_the_first_ten_sightings_contradict_a_site_of_the_wrong_sign(
    begin: datetime, site: Site, code: str | None
) -> None:
    unix_s, pixels = seen_from(begin)
    found = site_contradiction(unix_s, pixels, site=site, image_size=SIZE, mirrored="no")
    assert (None if found is None else found.code) == code


def test_a_mirrored_image_goes_the_other_way_unless_that_is_known() -> None:
    unix_s, pixels = seen_from(MORNING)
    mirrored = np.column_stack([SIZE[0] - 1.0 - pixels[:, 0], pixels[:, 1]])
    codes = {}
    for hand in ("no", "yes", "auto"):
        found = site_contradiction(unix_s, mirrored, site=SGP, image_size=SIZE, mirrored=hand)
        codes[hand] = None if found is None else found.code
    assert codes == {"no": "sun_contradicts_site", "yes": None, "auto": None}


@pytest.mark.parametrize("begin", [datetime(2013, 3, 21, 13, tzinfo=UTC), datetime(2013, 12, 21, 23, tzinfo=UTC)])
def test_a_lens_that_compresses_the_rim_does_not_contradict_a_right_site(begin: datetime) -> None:
    """A level orthographic camera in the tropics, by its formula; the sun is 73 to 84 degrees from the zenith."""
    site = replace(SGP, latitude=10.0)
    unix_s = np.asarray(begin.timestamp() + 300.0 * np.arange(10), dtype=np.float64)
    east, north, _ = np.moveaxis(sun_directions(unix_s, site), -1, 0)
    pixels = np.column_stack([500.0 - 480.0 * east, 500.0 - 480.0 * north])
    for stated, contradicted in ((site, False), (replace(site, longitude=-site.longitude), True)):
        found = site_contradiction(unix_s, pixels, site=stated, image_size=(1001, 1001), mirrored="no")
        assert (found is not None) == contradicted


@pytest.mark.parametrize("false", [1, 3])
def test_a_few_false_sightings_neither_hide_nor_make_a_contradiction(false: int) -> None:
    unix_s, pixels = seen_from(EVENING)
    pixels[:: 10 // false][:false] = (300.0, 1200.0)
    found = site_contradiction(unix_s, pixels, site=EAST, image_size=SIZE, mirrored="no")
    assert found is not None
    assert site_contradiction(unix_s, pixels, site=SGP, image_size=SIZE, mirrored="no") is None


def test_a_contradiction_says_which_way_the_sun_goes_and_where_it_should() -> None:
    unix_s, pixels = seen_from(EVENING)
    found = site_contradiction(unix_s, pixels, site=EAST, image_size=SIZE, mirrored="no")
    assert found is not None
    assert (found.data["seen"], found.data["expected"]) == ("sets", "rises")
    assert float(found.data["off_deg"]) > float(found.data["limit_deg"])
