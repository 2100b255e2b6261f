"""A disk on which each fsync takes 3 s: the service says so, with what waits, loses nothing, and makes up for it."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from tests.release.campaign import run_of
from tests.release.campaign_faults import Faults, Known, Source
from tests.release.campaign_processes import HERE, Setting, now

FSYNC_S = 3.0
SLOW_FOR_S = 180.0
SAID_WITHIN_S = 60.0
DONE_WITHIN_S = 120.0
SETTING = Setting(speed=10.0, cadence_s=60.0)
"""A slot takes 6 s, in which two commits end at most."""

pytestmark = [
    pytest.mark.gige,
    pytest.mark.system,
    pytest.mark.release,  # minutes of waiting
    pytest.mark.timeout(900),
    pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler"),
]


@pytest.fixture
def folder() -> Iterator[Path]:
    with TemporaryDirectory(prefix="sunarc-slow-disk-") as made:
        Path(made).chmod(0o755)  # PostgreSQL's user comes there
        yield Path(made)


def slow_disk(folder: Path) -> dict[str, str]:
    """Return the environment of a process whose every fsync takes as long as the file `slow` says, if it is there."""
    library = folder / "slow_fsync.so"
    subprocess.run(
        ["cc", "-shared", "-fPIC", "-Wall", "-Wextra", "-Werror", "-o", library, HERE / "slow_fsync.c", "-ldl"],
        check=True,
    )
    return {"LD_PRELOAD": str(library), "SLOW_FSYNC": str(folder / "slow")}


def conditions(run: Faults) -> dict[str, dict[str, Any]]:
    """Return the data of the conditions in /readyz by their codes."""
    answer = run.get("/readyz") or {"findings": []}
    return {finding["code"]: finding["data"] for finding in answer["findings"]}


def pending(run: Faults, since: Known) -> list[str]:
    """Return what waits: frames of before, files without a sighting, rows that the hub has not, and the condition."""
    missing = run.awaited(since)
    return missing or ([] if run.hub is None else run.hub.missing(run.hub.rows_of(run.database), run.database))


@pytest.mark.parametrize("source", ["gige", "folder"])
def test_a_disk_with_an_fsync_of_3_s_is_said_and_nothing_waits_2_minutes_after_it(folder: Path, source: Source) -> None:
    run = run_of(source, folder, seed=1, setting=SETTING)
    run.environment = slow_disk(folder)
    with run:
        run.wait(5.0 * run.slot_s)
        assert "database_slow" not in conditions(run)
        (folder / "slow").write_text(f"{FSYNC_S:g}")
        began, said_s, waiting = now(), float("inf"), 0
        while now() - began < SLOW_FOR_S:
            run.wait(1.0)
            found = conditions(run).get("database_slow")
            if found is not None:
                said_s = min(said_s, now() - began)
                waiting = max(waiting, int(found["waiting"]))
        since = run.known()
        (folder / "slow").unlink()
        ended = now()
        assert since is not None
        while (left := pending(run, since)) and now() - ended < DONE_WITHIN_S:
            run.wait(1.0)
        run.note(f"said after {said_s:.1f} s, {waiting} waited, all stored after {now() - ended:.1f} s")
        assert run.judge is not None
        assert (left, run.judge.check().wrong) == ([], [])
        assert said_s <= SAID_WITHIN_S
        assert waiting >= 1
