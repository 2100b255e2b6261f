"""A followed folder's older images, analysed as `ingest` does: in a process of low priority, behind the live ones."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Container, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass
from datetime import date, timedelta
from functools import partial
from typing import Protocol

from sunarc.common.errors import OutsideError
from sunarc.common.findings import Finding
from sunarc.common.utc import DAY_S, EPOCH
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.seen_files import SeenFile
from sunarc.imager.cameras.options import FolderOptions
from sunarc.imager.live.folder_files import changed_s
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.loop import Attempts, Loop, Pauses
from sunarc.imager.runtime.status import Reason, StatusRegistry
from sunarc.imager.settings.model import Settings
from sunarc.imager.workers.calibrating.solver_process import ChildControl, SolveFailedError, SolverDiedError, in_child
from sunarc.imager.workers.clock_watch import FrameTime
from sunarc.sky.days import solar_date
from sunarc.sources.image_times import TimeRules
from sunarc.sources.source_files import SourceFile

_log = logging.getLogger(__name__)
_LOOK_S = 2.0
_COUNT_S = 30.0
_AGAIN = Pauses(60.0, 3600.0)
"""After a failure: a share is back in a minute, a disk that is full perhaps in hours."""
_LONGEST_S = 14 * DAY_S
"""Of one analysis: a year's images of 12 MP on a small computer take days."""
_PORTION = 2000
"""Older images that are analysed at once, the newest first: their days are judged before those of the rest."""
_IN_WORK, _FAILED = "archive_in_work", "archive_failed"


class DaysUntil:
    """Container of all days until one, and of some other days.

    Parameters
    ----------
    last, others : of the days.
    """

    def __init__(self, last: date, others: Container[date]) -> None:
        self._last, self._others = last, others

    def __contains__(self, day: object) -> bool:
        """Return whether a day is one of them."""
        return isinstance(day, date) and (day <= self._last or day in self._others)


class FolderAnalysis(Protocol):
    """Analysis of the files of a followed folder in both passes of `sunarc ingest`; called in a process of its own."""

    def __call__(self, settings: Settings, *, rules: TimeRules, only: frozenset[str] | None) -> bool:
        """Store the sightings of the files that are named, or of all for None, and return that it was done."""


@dataclass(eq=False)
class FolderArchiveWorker:
    """Analyses the older images of the folder in a child process, when there is a reason to.

    Reasons are many older files at a start; a day that ended before there was a calibration, whose images were searched
    without a prediction; and the first calibration, which predicts the sun in them.

    Parameters
    ----------
    options : the folder.
    rules : how times are read.
    settings : of the service.
    camera : its archive.
    clock, frame_time : real time, and that of the images.
    board : where the progress is shown.
    analysis : of the files; None leaves them to `sunarc ingest`.
    look_back : called once sightings of earlier days are stored: these may be judged.
    """

    options: FolderOptions
    _: KW_ONLY
    rules: TimeRules
    settings: Settings
    camera: CameraArchive
    clock: Clock
    frame_time: FrameTime
    board: StatusRegistry
    analysis: FolderAnalysis | None = None
    look_back: Callable[[], None] = lambda: None

    def __post_init__(self) -> None:
        """Begin with nothing to analyse."""
        self._lock = threading.Lock()
        self._older: tuple[SourceFile, ...] = ()
        self._analysed: date | None = None
        self._calibrated: bool | None = None
        self._working = False
        self._rests_until_s = 0.0
        self._attempts = Attempts(
            self.clock,
            _AGAIN,
            board=self.board,
            code=_FAILED,
            reason=lambda error, _hours: Reason.of(Finding(_FAILED, {"error": error})),
        )

    def analyse(self, files: Sequence[SourceFile]) -> None:
        """Have older files of the folder analysed, and all of it once they led to a calibration."""
        with self._lock:
            self._older = tuple(sorted((*self._older, *files), key=changed_s, reverse=True))
        with suppress(OutsideError):  # the database refuses for a while
            self._note_day_and_calibration()

    @property
    def is_busy(self) -> bool:
        """Return whether an analysis is going on or due."""
        return self._working or (not self._is_pausing and (bool(self._older) or self._is_due()))

    @property
    def holds_all_days(self) -> bool:
        """Return whether an analysis is going on or due that any day waits for."""
        return self.is_busy and not self._older

    def waiting_days(self, others: Container[date]) -> Container[date]:
        """Return the days of which older images are still to be analysed, and other ones that wait."""
        older = self._older
        return (
            others if self._is_pausing or not older else DaysUntil(self._mean_solar_date(changed_s(older[0])), others)
        )

    @property
    def _is_pausing(self) -> bool:
        """Return whether an analysis has failed lately: until the next one, days are judged by the stored sightings."""
        return self.clock.monotonic() < self._rests_until_s

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Analyse the folder whenever an analysis is due, until stopped."""
        loop = Loop(self.clock, stop, heartbeat)
        for _ in loop.turns():
            self.step(stop, heartbeat)
            loop.wait(_LOOK_S)

    def step(self, stop: threading.Event, heartbeat: Callable[[], None]) -> bool:
        """Analyse the folder if an analysis is due; return whether one was made."""
        if self.analysis is None or self._is_pausing or not (self._older or self._is_due()):
            return False
        files = self._older[:_PORTION]
        self._working = True
        self.board.set_condition(_FAILED, None)
        try:
            answer = self._run_analysis(self.analysis, files, stop, heartbeat)
            if answer is True:
                self._mark_seen(files)
            elif answer is not None:
                self._note_failure(str(answer))
        except (OutsideError, SolverDiedError, SolveFailedError) as error:
            self._note_failure(str(error))
        finally:
            self._working = False
            self.board.set_condition(_IN_WORK, None)
        return True

    def _is_due(self) -> bool:
        """Return whether an analysis is due: a day ended without a calibration, or the first one was made."""
        self._note_day_and_calibration()
        today = self._current_solar_date()
        if self._calibrated and self._has_calibration():
            self._analysed = today
            return False
        known = self.camera.archive.cameras.get(self.camera.name) is not None
        return known and (today != self._analysed or self._calibrated != self._has_calibration())

    def _note_day_and_calibration(self) -> None:
        """Take note of the day and of whether there is a calibration, the first time."""
        if self._analysed is None:
            self._analysed, self._calibrated = self._current_solar_date(), self._has_calibration()

    def _current_solar_date(self) -> date:
        """Return the present date in the site's mean solar time."""
        return self._mean_solar_date(self.frame_time.now().timestamp())

    def _mean_solar_date(self, unix_s: float) -> date:
        return solar_date(unix_s, longitude=self.camera.site.longitude)

    def _has_calibration(self) -> bool:
        return self.camera.archive.calibrations.current(self.camera.name) is not None

    def _run_analysis(
        self,
        analysis: FolderAnalysis,
        files: Sequence[SourceFile],
        stop: threading.Event,
        heartbeat: Callable[[], None],
    ) -> object:
        only = frozenset(file.name for file in files) if files else None
        call = partial(analysis, self.settings, rules=self.rules, only=only)
        before, next_s = self._count_stored(), self.clock.monotonic()

        def report_progress() -> None:
            nonlocal next_s
            heartbeat()
            if files and self.clock.monotonic() >= next_s:
                next_s = self.clock.monotonic() + _COUNT_S
                found = Finding(_IN_WORK, {"n": len(self._older), "stored": self._count_stored() - before})
                self.board.set_condition(_IN_WORK, Reason.of(found))

        return in_child(call, ChildControl(self.clock, _LONGEST_S, stop, report_progress))

    def _count_stored(self) -> int:
        until = self.frame_time.now() + timedelta(days=1)
        return sum(self.camera.archive.sightings.count(self.camera.name, since=EPOCH, until=until).values())

    def _mark_seen(self, files: Sequence[SourceFile]) -> None:
        """Store the files as seen, after their sightings: an interrupted analysis begins again with the rest."""
        seen = (SeenFile(camera=self.camera.name, file=one.name, stamp=one.stamp) for one in files)
        self.camera.archive.seen_files.add(seen)
        with self._lock:
            done = {one.name for one in files}
            self._older = tuple(one for one in self._older if one.name not in done)
        self.look_back()
        if not files:
            self._analysed, self._calibrated = self._current_solar_date(), self._has_calibration()
        self._attempts.succeeded()

    def _note_failure(self, error: str) -> None:
        _log.warning("the older images of %s could not be analysed: %s", self.options.path, error)
        self._rests_until_s = self.clock.monotonic() + self._attempts.failed(error)
