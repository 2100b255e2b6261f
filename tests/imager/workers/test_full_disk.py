"""A real disk that is full: a small tmpfs, filled by images, by strangers, and to the last byte."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from sunarc.common.errors import OutsideError
from sunarc.detection.values import DiscOptions
from sunarc.imager.archive.archive import CameraArchive, open_archive
from sunarc.imager.archive.database.schema import check, upgrade
from sunarc.imager.archive.database.store import Reserve
from sunarc.imager.archive.images import DiskOptions, ImageStore
from sunarc.imager.archive.values import CameraRecord
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.host import prepare_state
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.workers.compose import ComposeWorker
from sunarc.imager.workers.detect import DetectWorker, FrozenFrames, SightingWriteBuffer
from sunarc.imager.workers.options import SensorOptions
from sunarc.imager.workers.sun_prediction import SunPredictor
from sunarc.imager.workers.upkeep import DiskWorker
from sunarc.sky.site import Site

from .conftest import NOON

if TYPE_CHECKING:
    from sunarc.imager.runtime.clock import VirtualClock
    from sunarc.imager.runtime.status import StatusRegistry

SGP = Site(latitude=36.604043, longitude=-97.484856, altitude=318.0)
OPTIONS = DiskOptions(keep_free_mb=6.0, reserve_mb=2.0)
EXPOSURES_US = (3_000.0, 12_000.0, 48_000.0)


@contextmanager
def mounted(folder: Path, *options: str) -> Iterator[None]:
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", ",".join(options), "tmpfs", str(folder)], check=False, capture_output=True
    )
    if done.returncode:
        pytest.skip(f"no tmpfs can be mounted here: {done.stderr.decode().strip()}")
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


@pytest.fixture
def state(tmp_path: Path) -> Iterator[Path]:
    if os.geteuid() != 0:
        pytest.skip("mounting a small disk needs root")
    folder = tmp_path / "state"
    folder.mkdir()
    with mounted(folder, "size=24m"):
        yield folder


def frame(number: int, exposure_us: float) -> Frame:
    """Return noise, which no compression makes smaller, or the night for the sun's exposures."""
    noise = np.random.default_rng(number).integers(0, 4000, (600, 600), dtype=np.uint16)
    return Frame(
        image=noise if exposure_us > 100.0 else np.zeros_like(noise),
        time=NOON + timedelta(seconds=30 * number),
        exposure_us=exposure_us,
        gain_db=0.0,
        pixel_format="Mono12",
        full_scale=4095,
        frame_id=number,
    )


class Chain:
    """The parts of the service that write to the disk."""

    def __init__(self, state: Path, clock: VirtualClock, board: StatusRegistry) -> None:
        upgrade(state / "sunarc.sqlite")
        self.archive = open_archive(state / "sunarc.sqlite")
        record = CameraRecord(name="roof", latitude=36.6, longitude=-97.5, altitude=318.0, width=600, height=600)
        self.archive.cameras.save(record)
        self.store = ImageStore(state / "images", options=OPTIONS)
        predictor = SunPredictor(CameraArchive(self.archive, name="roof", site=SGP))
        self.keeper = SightingWriteBuffer(self.archive, board=board)
        self.compose = ComposeWorker(
            DropOldestQueue(capacity=4),
            store=self.store,
            options=SensorOptions(),
            describe=lambda frames, _: {"schema": "sunarc.image/1", "time_utc": frames[0].time.isoformat()},
            board=board,
        )
        self.detect = DetectWorker(
            DropOldestQueue(capacity=4),
            keeper=self.keeper,
            camera="roof",
            predictor=predictor,
            options=SensorOptions(),
            disc=DiscOptions(),
            clock_error_s=lambda _: 0.01,
            report=lambda _frame, _detection: None,
            board=board,
            frozen=FrozenFrames(CameraArchive(self.archive, name="roof", site=SGP), board=board),
            cadence_s=30.0,
        )
        self.disk = DiskWorker(
            store=self.store,
            reserve=Reserve(state / "reserve", size_bytes=2_000_000),
            options=OPTIONS,
            clock=clock,
            age_from=lambda: None,
            board=board,
        )

    def cycle(self, number: int) -> None:
        self.compose.compose([frame(number, exposure_us) for exposure_us in EXPOSURES_US])
        self.detect.process(frame(number, 20.0))

    def stored(self) -> int:
        return len(self.archive.sightings.find("roof"))


def fill(path: Path) -> None:
    """Take what is left, to the last byte, as a stranger's log would."""
    with path.open("ab") as file:
        while True:
            try:
                os.write(file.fileno(), bytes(4096))
            except OSError:
                return


def codes(board: StatusRegistry) -> set[str]:
    return {reason.code for reason in board.snapshot().reasons}


def test_images_make_room_and_the_database_is_never_the_victim(
    state: Path, clock: VirtualClock, board: StatusRegistry
) -> None:
    chain = Chain(state, clock, board)
    for number in range(40):
        chain.cycle(number)
        chain.disk.check()
    kept = sorted(path.name for path in (state / "images").rglob("*_hdr.png"))
    assert 10 < len(kept) < 30
    assert kept[-1].startswith((NOON + timedelta(seconds=30 * 39)).strftime("%Y%m%dT%H%M%S"))
    usage = chain.store.usage()
    assert usage.free_bytes >= 6_000_000
    assert usage.images_bytes > 8_000_000
    assert chain.stored() == 40
    assert codes(board) == set()


def test_a_disk_filled_by_a_stranger_costs_images_and_no_sighting(
    state: Path, clock: VirtualClock, board: StatusRegistry
) -> None:
    chain = Chain(state, clock, board)
    for number in range(10):
        chain.cycle(number)
    chain.disk.check()
    for _ in range(10):  # the images go, and then the reserve
        if (state / "reserve").exists():
            fill(state / "stranger")
            chain.disk.check()
    assert chain.store.usage().images_bytes == 0
    assert not (state / "reserve").exists()
    for number in range(10, 15):
        chain.cycle(number)
    assert chain.stored() == 15
    assert codes(board) == {"disk_full", "images_not_written"}

    fill(state / "stranger")  # and now there is nothing
    for number in range(15, 115):
        chain.detect.process(frame(number, 20.0))
    assert "sightings_not_stored" in codes(board)
    assert chain.keeper.waiting > 0
    assert chain.stored() + chain.keeper.waiting == 115

    (state / "stranger").unlink()
    chain.disk.check()
    chain.cycle(115)
    assert chain.stored() == 116
    assert codes(board) == set()
    assert (state / "reserve").exists()
    assert check(state / "sunarc.sqlite").sound


def test_a_state_folder_on_a_disk_that_cannot_be_written_to_is_refused_with_the_remedy(state: Path) -> None:
    subprocess.run(["mount", "-o", "remount,ro", str(state)], check=True)
    for folder in (state, state / "images"):
        with pytest.raises(OutsideError, match="`state`"):
            prepare_state(folder)


SPILLING = """
import sys
from pathlib import Path
from sunarc.common.errors import StoreFullError
from sunarc.imager.archive.archive import open_archive

archive = open_archive(Path(sys.argv[1]))
rows = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 20000) SELECT randomblob(1000) FROM n"
try:
    with archive.database.writing(camera=None) as connection:
        connection.exec_driver_sql(f"CREATE {sys.argv[2]} many AS {rows}")
except StoreFullError as error:
    print(error)
"""
"""20 MB, more than SQLite keeps in memory, in the database or in its temporary files."""


@pytest.mark.parametrize(("table", "full"), [("TEMP TABLE", "temporary"), ("TABLE", "state")])
def test_the_disk_that_is_full_is_named(tmp_path: Path, table: str, full: str) -> None:
    if os.geteuid() != 0:
        pytest.skip("mounting a small disk needs root")
    folders = {"temporary": tmp_path / "temporary", "state": tmp_path / "state"}
    for folder in folders.values():
        folder.mkdir()
    with mounted(folders["temporary"], "size=8m"), mounted(folders["state"], "size=8m"):
        file = folders["state"] / "sunarc.sqlite"
        upgrade(file)
        environment = {**os.environ, "SQLITE_TMPDIR": str(folders["temporary"])}
        command = [sys.executable, "-c", SPILLING, str(file), table]
        done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True, timeout=120)
    disk = done.stdout.partition(", which")[0].partition(" is full")[0]
    assert str(folders[full]) in disk
    assert sum(str(folder) in disk for folder in folders.values()) == 1
