"""Disk space: removal of old images, and the reserve of the database."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from datetime import datetime, timedelta

from sunarc.archive.images import DiskOptions, DiskUsage, ImageStore
from sunarc.archive.space_reserve import Reserve
from sunarc.errors import OutsideError
from sunarc.runtime.clock import Clock
from sunarc.runtime.status import DiskStatus, Reason, StatusRegistry
from sunarc.workers.messages import condition

_log = logging.getLogger(__name__)
_POLL_S = 1.0  # the heartbeat's
_CHECK_EVERY_S = 5.0
"""Seconds from check to check: a full cycle's images in between are far below what is kept free."""
_UNREADABLE = "images_unreadable"
_FULL = ("disk_low", "disk_full", "disk_no_inodes")


class DiskWorker:
    """Checks the disk periodically, removes images by age and by free space, and publishes the disk's state.

    Parameters
    ----------
    store : the images.
    reserve : space for the database, released when the disk is full and taken again when it is not.
    options : how much images may have.
    clock : real time.
    age_from : the time that the age of images is counted from; None while it cannot be trusted.
    board : where the disk's state is shown.
    """

    def __init__(
        self,
        *,
        store: ImageStore,
        reserve: Reserve,
        options: DiskOptions,
        clock: Clock,
        age_from: Callable[[], datetime | None],
        board: StatusRegistry,
    ) -> None:
        self._store = store
        self._reserve = reserve
        self._options = options
        self._clock = clock
        self._age_from = age_from
        self._board = board

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Check until stopped."""
        self._clear_up()
        due_s = self._clock.monotonic()
        while not stop.is_set():
            heartbeat()
            if self._clock.monotonic() >= due_s:
                self.check()
                due_s = self._clock.monotonic() + _CHECK_EVERY_S
            self._clock.wait(stop, _POLL_S)

    def check(self) -> None:
        """Check once; a folder that cannot be read becomes a condition, and is checked again."""
        try:
            self._check()
        except (OutsideError, OSError) as error:
            self._board.set_condition(_UNREADABLE, condition(_UNREADABLE, error=str(error)))
        else:
            self._board.set_condition(_UNREADABLE, None)

    def _clear_up(self) -> None:
        try:
            self._store.clear_up()
        except OutsideError as error:
            self._board.set_condition(_UNREADABLE, condition(_UNREADABLE, error=str(error)))

    def _check(self) -> None:
        now = self._age_from()
        if now is not None:
            keep = self._options.keep_days
            removed = self._store.expire(now - timedelta(days=keep), keep_newest_days=int(keep))
            if removed:
                _log.info("%d images older than %g days were removed", removed, self._options.keep_days)
        has_space = self._store.make_room()
        usage = self._store.usage()
        self._reserve.balance(usage.free_bytes)
        self._publish(usage, has_space=has_space)

    def _publish(self, usage: DiskUsage, *, has_space: bool) -> None:
        self._board.note(
            disk=DiskStatus(
                free_bytes=usage.free_bytes,
                images_bytes=usage.images_bytes,
                oldest_image_at=usage.oldest_image_at,
            )
        )
        self._board.set_one_condition(_FULL, self._reason(usage, has_space=has_space))

    def _reason(self, usage: DiskUsage, *, has_space: bool) -> Reason | None:
        if usage.out_of_files:
            code = "disk_no_inodes"
        elif has_space:
            return None
        else:
            code = "disk_low" if self._reserve.held() else "disk_full"
        free_mb, images_mb = usage.free_bytes / 1e6, usage.images_bytes / 1e6
        return condition(code, folder=str(self._store.folder), free_mb=free_mb, images_mb=images_mb)
