"""Images and tables of others, whose right answers are known: suns and stars."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.fixtures.command_line import Sunarc

from sunarc.archive.csv_files import read_sightings
from sunarc.calibration.model.sightings import Kind
from sunarc.detection.values import Expectation
from sunarc.documents.calibration_document import from_document
from sunarc.optics.forward import project
from sunarc.reanalysis.detect_files import detect_in_image

CASES = Path(__file__).parents[2] / "../shared/cases"


def case(name: str) -> str:
    path = CASES / name
    if not path.exists():
        pytest.skip(f"{name} is not on this machine")
    return str(path)


def test_lamps_and_roofs_at_the_places_of_stars_get_an_answer(sunarc: Sunarc) -> None:
    site = ["--latitude", "44.2466", "--longitude", "19.9306", "--altitude", "190"]
    when = ["--utc-offset", "0", "--to-middle", "87"]
    done = sunarc("stars", case("real/petnica_20151203_042345.jpg"), "--blind", *site, *when)
    assert done.code in {0, 1}, done.err
    assert "{'" not in done.out  # a sentence for every finding


def test_a_few_biased_suns_do_not_veto_the_stars(sunarc: Sunarc) -> None:
    site = ["--latitude", "37.0916", "--longitude", "-2.3636", "--altitude", "490.6", "--image-size", "1000,1000"]
    table = case("peers/mix2.csv")
    done = sunarc("calibrate", table, *site)
    assert done.code == 0, done.err
    assert "30 sightings of the day" in done.out + done.err
    document = json.loads(sunarc("calibrate", table, *site, "--json").out)
    assert "day_contradicts_night" in {one["code"] for one in document["verdict"]["findings"]}
    assert document["uncertainty"]["sky_rms_deg"] < 0.03
    # the stars alone, whose camera is right to 0.02 degrees
    of_stars = from_document(document)
    points = read_sightings(Path(table).read_text(encoding="utf-8").splitlines(), name="mix2")
    stars = points.select(points.kind == Kind.STAR)
    off = np.linalg.norm(stars.pixels - project(of_stars.camera, stars.directions), axis=-1)
    assert 0.04 < np.median(off) < 0.1


@pytest.mark.parametrize(
    ("name", "left", "top", "seen", "sun"),
    [
        ("false_sun_fe3_20160901_095600Z.png", 260, 980, (504.116, 1157.8219), (472.5, 1209.6)),
        ("false_sun_fe4_20160901_094000Z.png", 620, 150, (852.7727, 326.5142), (842.1, 377.1)),
    ],
)
def test_gaps_in_broken_cloud_are_no_suns(
    name: str, left: int, top: int, seen: tuple[float, float], sun: tuple[float, float]
) -> None:
    image = cv2.imread(case(f"real/{name}"))
    assert image is not None
    whole = np.full((1920, 1920, 3), 120, dtype=np.uint8)
    whole[top : top + image.shape[0], left : left + image.shape[1]] = image
    place = Expectation(x_px=seen[0], y_px=seen[1], uncertainty_px=10.0)
    for expectation in (None, place):
        found = detect_in_image(whole, expectation=expectation)
        if found.accepted:
            off = np.hypot((found.x_px or 0.0) - sun[0], (found.y_px or 0.0) - sun[1])
            assert off <= 5.0 * (found.sigma_px or 0.0)
