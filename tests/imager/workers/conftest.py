from __future__ import annotations

import threading
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from tests.fixtures.board import status_registry
from tests.fixtures.calibrations import SITE
from tests.fixtures.cameras import INFO

from sunarc.calibration.model.options import CalibrationOptions
from sunarc.common.errors import CameraError
from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.cameras.frame import CameraCondition, CameraInfo, Frame
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.calibrating.refit import RefitWorker
from sunarc.imager.workers.options import RefitOptions

NOON = datetime(2013, 5, 13, 18, 30, 10, tzinfo=UTC)


@dataclass
class FakeCamera:
    """Answers with black frames, and with the faults that it is given, in turn."""

    clock: VirtualClock
    faults: list[CameraError | None] = field(default_factory=list)
    exposures: list[tuple[float, float]] = field(default_factory=list)
    changed: list[CameraError | None] = field(default_factory=list)
    distrusted: int = 0
    closed: int = 0
    info: CameraInfo = INFO

    def expose(self, exposure_us: float) -> Frame:
        self.exposures.append((self.clock.monotonic(), exposure_us))
        self.clock.advance(exposure_us * 1e-6)
        fault = self.faults.pop(0) if self.faults else None
        if fault is not None:
            raise fault
        return Frame(
            image=np.zeros((6, 8), dtype=np.uint16),
            time=self.clock.now() - timedelta(microseconds=exposure_us / 2.0),
            exposure_us=exposure_us,
            gain_db=0.0,
            pixel_format="Mono12",
            full_scale=4095,
            frame_id=len(self.exposures),
        )

    def distrust(self) -> None:
        self.distrusted += 1

    def check(self) -> CameraCondition:
        change = self.changed.pop(0) if self.changed else None
        if change is not None:
            raise change
        return CameraCondition(temperature_c=30.0)

    def close(self) -> None:
        self.closed += 1


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock(NOON)


@pytest.fixture
def board(clock: VirtualClock) -> StatusRegistry:
    return status_registry(clock)


@pytest.fixture
def camera(clock: VirtualClock) -> FakeCamera:
    return FakeCamera(clock)


def refit_worker(
    archive: Archive,
    board: StatusRegistry,
    clock: VirtualClock,
    *,
    now: datetime,
    cadence_s: float,
    **changes: Any,  # noqa: ANN401 - of its arguments
) -> RefitWorker:
    """Return the refit worker of the camera "roof" at the paper's site."""
    return RefitWorker(
        camera=CameraArchive(archive, name="roof", site=SITE),
        options=RefitOptions(),
        calibration=CalibrationOptions(),
        cadence_s=cadence_s,
        clock=clock,
        now=lambda: now,
        board=board,
        **changes,
    )


class StopAfter(threading.Event):
    """Is set by itself after it was asked so many times."""

    def __init__(self, times: int) -> None:
        super().__init__()
        self._left = times

    def is_set(self) -> bool:
        self._left -= 1
        return self._left < 0 or super().is_set()
