"""Images and tables of others, whose right answers are known: suns and stars."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.fixtures.command_line import Sunarc

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
