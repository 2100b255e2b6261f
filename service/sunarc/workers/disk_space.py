"""Keeps the disk from filling: old images go, and the database has room set aside."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from datetime import datetime, timedelta

from sunarc.archive import DiskOptions, DiskUsage, ImageStore, Reserve
from sunarc.errors import OutsideError
from sunarc.runtime.clock import Clock
from sunarc.runtime.status import DiskStatus, Reason, StatusRegistry

_log = logging.getLogger(__name__)
_POLL_S = 1.0  # the heartbeat's
_CHECK_EVERY_S = 5.0
"""Seconds from check to check: a full cycle's images in between are far below what is kept free."""
_UNREADABLE = "images_unreadable"


class DiskWorker:
    """Looks at the disk again and again: removes what is too old or too much, and says how much is left.

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
        self._shown: str | None = None
        self._unreadable = False

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Look until stopped."""
        self._clear_up()
        due_s = self._clock.monotonic()
        while not stop.is_set():
            heartbeat()
            if self._clock.monotonic() >= due_s:
                self.look()
                due_s = self._clock.monotonic() + _CHECK_EVERY_S
            self._clock.wait(stop, _POLL_S)

    def look(self) -> None:
        """Look once; a folder that cannot be read is shown, and looked at again."""
        try:
            self._look()
        except (OutsideError, OSError) as error:
            self._show_unreadable(error)
        else:
            self._board.clear_reason(_UNREADABLE)
            if self._unreadable:
                self._unreadable = False
                _log.info("the image folder %s can be read again", self._store.folder)

    def _clear_up(self) -> None:
        try:
            self._store.clear_up()
        except OutsideError as error:
            self._show_unreadable(error)

    def _show_unreadable(self, error: Exception) -> None:
        remedy = "give the folder back to the service's user and mount its disk; rechecked automatically"
        self._board.set_reason(Reason(code=_UNREADABLE, severity="degraded", text=str(error), remedy=remedy))
        if not self._unreadable:
            self._unreadable = True
            _log.error("%s; %s", error, remedy)

    def _look(self) -> None:
        now = self._age_from()
        if now is not None:
            keep = self._options.keep_days
            removed = self._store.expire(now - timedelta(days=keep), keep_newest_days=int(keep))
            if removed:
                _log.info("%d images older than %g days were removed", removed, self._options.keep_days)
        roomy = self._store.make_room()
        usage = self._store.usage()
        self._reserve.balance(usage.free_bytes)
        self._show(usage, roomy=roomy)

    def _show(self, usage: DiskUsage, *, roomy: bool) -> None:
        self._board.note(
            disk=DiskStatus(
                free_bytes=usage.free_bytes,
                images_bytes=usage.images_bytes,
                oldest_image_at=usage.oldest_image_at,
            )
        )
        if usage.out_of_files:
            reason = self._no_files(usage)
        elif roomy:
            reason = None
        elif self._reserve.held():
            reason = self._low(usage, code="disk_low", text="has less room than is kept for the database")
        else:
            reason = self._low(usage, code="disk_full", text="is full; the database lives on its reserve")
        for code in {"disk_low", "disk_full", "disk_no_inodes"} - ({reason.code} if reason else set()):
            self._board.clear_reason(code)
        if reason is not None:
            self._board.set_reason(reason)
        self._tell(reason)

    def _no_files(self, usage: DiskUsage) -> Reason:
        return Reason(
            code="disk_no_inodes",
            severity="degraded",
            text=f"the file system of {self._store.folder} has no inodes left, with {usage.free_bytes / 1e6:.0f} MB "
            "free; no file can be made",
            remedy="remove small files from it (df -i shows the file system); rechecked automatically",
        )

    def _low(self, usage: DiskUsage, *, code: str, text: str) -> Reason:
        return Reason(
            code=code,
            severity="degraded",
            text=f"the disk of {self._store.folder} {text}: {usage.free_bytes / 1e6:.0f} MB are free, "
            f"and images take {usage.images_bytes / 1e6:.0f} MB; no composite is kept",
            remedy="free space on this disk, or lower disk.keep_free_mb; it is looked at again by itself",
        )

    def _tell(self, reason: Reason | None) -> None:
        """Log a change, once."""
        code = None if reason is None else reason.code
        if code == self._shown:
            return
        self._shown = code
        if reason is None:
            _log.info("the disk of %s has room again", self._store.folder)
        else:
            _log.error("%s; %s", reason.text, reason.remedy)
