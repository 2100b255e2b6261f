"""An image folder that cannot be read, and a file system without inodes: shown, and recovered from."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from sunarc.common.errors import OutsideError
from sunarc.imager.archive.database.store import Reserve
from sunarc.imager.archive.images import DiskOptions, ImageStore
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.host import prepare_state
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.workers.compose import ComposeWorker
from sunarc.imager.workers.options import SensorOptions
from sunarc.imager.workers.upkeep import DiskWorker

from .conftest import NOON
from .test_database import as_nobody
from .test_full_disk import mounted

if TYPE_CHECKING:
    from sunarc.imager.runtime.clock import VirtualClock
    from sunarc.imager.runtime.status import StatusRegistry

__all__ = ["as_nobody"]
OPTIONS = DiskOptions(keep_free_mb=2.0, reserve_mb=1.0)


def worker_of(state: Path, clock: VirtualClock, board: StatusRegistry) -> DiskWorker:
    store = ImageStore(state / "images", options=OPTIONS)
    reserve = Reserve(state / "reserve", size_bytes=1_000_000)
    return DiskWorker(store=store, reserve=reserve, options=OPTIONS, clock=clock, age_from=clock.now, board=board)


def compose(worker: DiskWorker, board: StatusRegistry) -> None:
    composer = ComposeWorker(
        DropOldestQueue(capacity=1),
        store=worker.store,
        options=SensorOptions(),
        describe=lambda *_: {"time_utc": "2013-05-13T18:30:10Z"},
        board=board,
    )
    frames = [
        Frame(image=np.full((6, 8), 100, dtype=np.uint16), time=NOON, exposure_us=exposure_us, gain_db=0.0,
              pixel_format="Mono12", full_scale=4095, frame_id=1)
        for exposure_us in (3_000.0, 12_000.0)
    ]  # fmt: skip
    composer.compose(frames)


def codes(board: StatusRegistry) -> set[str]:
    return {reason.code for reason in board.snapshot().reasons}


@pytest.mark.usefixtures("as_nobody")
@pytest.mark.parametrize("which", ["images", "."])
def test_an_unreadable_folder_is_a_condition_that_ends_with_its_cause(
    tmp_path: Path, clock: VirtualClock, board: StatusRegistry, which: str
) -> None:
    state = tmp_path / "state"
    (state / "images").mkdir(parents=True)
    worker = worker_of(state, clock, board)
    worker.check()
    (state / which).chmod(0)
    with pytest.raises(OutsideError, match="`state`"):
        prepare_state(state / which)
    worker.check()
    compose(worker, board)
    assert codes(board) == {"images_unreadable", "images_not_written"}
    (state / which).chmod(0o750)
    worker.check()
    compose(worker, board)
    assert codes(board) == set()
    assert worker.store.newest(kind="hdr.png") is not None


def test_a_file_system_without_inodes_is_said_to_be_one(
    tmp_path: Path, clock: VirtualClock, board: StatusRegistry
) -> None:
    state = tmp_path / "state"
    state.mkdir()
    with mounted(state, "size=50M", "nr_inodes=60"):
        (state / "images").mkdir()
        worker = worker_of(state, clock, board)
        worker.check()
        assert codes(board) == set()
        strangers = 0
        while True:
            try:
                (state / f"stranger{strangers}").touch()
            except OSError:
                break
            strangers += 1
        worker.check()
        compose(worker, board)
        assert codes(board) == {"disk_no_inodes", "images_not_written"}
        texts = {reason.code: reason.text for reason in board.snapshot().reasons}
        assert "no inodes are left" in texts["images_not_written"]
        for number in range(strangers):
            (state / f"stranger{number}").unlink()
        worker.check()
        compose(worker, board)
        assert codes(board) == set()
