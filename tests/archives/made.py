"""A small made archive, analysed in the test's own process."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.archives.in_process import InProcess, use

from sunarc.archives.results import Summary
from sunarc.archives.run import ReanalysisOptions, reanalyse
from sunarc.imager.runtime.clock import SystemClock
from sunarc.lab.simulation.made_archive import FOUR_CAMERAS, MadeArchive, write_archive
from sunarc.lab.simulation.truth import SGP
from sunarc.sources.index import CameraPlan, Indexed, Selector, index_archive, read_cameras

MADE = MadeArchive(cameras=FOUR_CAMERAS[:2], days=6, per_day=14, cloudy_share=0.15)
"""Of a bumped camera in a folder, and one in a zip file whose clock is an hour ahead on two days."""
TABLES = ("sightings.csv", "stars.csv", "epochs.json", "failures.csv")


def indexed_in(folder: Path, made: MadeArchive = MADE) -> Indexed:
    """Return the index of the archive in a folder, which is made where it is not there."""
    path = folder / "cameras.toml"
    if not path.exists():
        write_archive(made, folder)
    return index_archive(read_cameras(path, common=CameraPlan(name="all", site=SGP, selector=Selector(()))))


def analysed(
    indexed: Indexed,
    target: Path,
    patch: pytest.MonkeyPatch,
    *,
    exports: bool = False,
    most: int | None = None,
    store: str | None = None,
) -> tuple[Summary | None, InProcess]:
    """Return what a run comes to, and what it had looked at; None where it was ended after some chunks."""
    cluster = InProcess(most=most)
    use(cluster, patch)
    try:
        summary = reanalyse(
            indexed, ReanalysisOptions(target=target, store=store, exports=exports), clock=SystemClock()
        )
    except KeyboardInterrupt:
        return None, cluster
    return summary, cluster


def tables_in(target: Path) -> dict[str, bytes]:
    return {name: (target / name).read_bytes() for name in TABLES}
