"""The workers that store how the service is: disk space, temperature, and since when conditions hold."""

from __future__ import annotations

from datetime import datetime

from sunarc.app.service import Service
from sunarc.app.status_line import NO_FRAME_YET
from sunarc.archive.archive import Archive
from sunarc.runtime.clock import Clock
from sunarc.runtime.status import StatusRegistry
from sunarc.runtime.supervisor import Supervised
from sunarc.workers.condition_times import ConditionTimesWorker
from sunarc.workers.database_file import StoreRoomWorker
from sunarc.workers.housekeeping import HousekeepingWorker

_OF_THE_HUB = ""


def imager_recording(service: Service) -> tuple[Supervised, ...]:
    """Return the workers of an imager; made before its conditions are set, so that they go on where they were."""
    frame_time = service.frame_time

    def now() -> datetime | None:
        return frame_time.now() if frame_time.is_known and service.clock_watch.trusted() else None

    housekeeping = HousekeepingWorker(
        camera=service.camera,
        clock=service.clock,
        now=now,
        age_from=service.clock_watch.cleaning_time,
        board=service.board,
    )
    conditions = ConditionTimesWorker(
        archive=service.archive,
        camera=service.settings.name,
        board=service.board,
        clock=service.clock,
        passing=[NO_FRAME_YET],
    )
    return (
        Supervised(name="housekeeping", make_worker=lambda: housekeeping),
        Supervised(name="conditions", make_worker=lambda: conditions),
    )


def hub_recording(archive: Archive, board: StatusRegistry, clock: Clock) -> tuple[Supervised, ...]:
    """Return the workers of a hub's own conditions; whatever its database does, a restart of the hub helps nothing."""
    conditions = ConditionTimesWorker(archive=archive, camera=_OF_THE_HUB, board=board, clock=clock)
    room = StoreRoomWorker(archive=archive, clock=clock, board=board)
    return (
        Supervised(name="conditions", make_worker=lambda: conditions),
        Supervised(name="room", make_worker=lambda: room, optional=True),
    )
