"""A few faults of the campaign, as a test of tests/release/run; `tests/campaign --faults 300` is the long form."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from tests.release.campaign import SOURCES, campaign
from tests.release.campaign_faults import Source


@pytest.fixture
def folder() -> Iterator[Path]:
    with TemporaryDirectory(prefix="sunarc-campaign-") as made:
        Path(made).chmod(0o755)  # PostgreSQL's user comes there
        yield Path(made)


@pytest.mark.gige
@pytest.mark.system
@pytest.mark.release  # five faults show little beside what each kind's own test does
@pytest.mark.timeout(240)
@pytest.mark.parametrize("source", SOURCES)
def test_a_short_campaign_of_faults_finds_nothing_wrong(folder: Path, source: Source) -> None:
    found, counts = campaign(seed=3, faults=5, folder=folder, most_s=20.0, source=source)
    assert counts
    assert found.n_sightings >= 5
    assert found.good, found
