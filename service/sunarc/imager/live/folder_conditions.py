"""Dating and verdicts of a followed folder's images: left out, ahead of the clock, or late after their times."""

from __future__ import annotations

from collections import Counter, deque
from datetime import datetime

import numpy as np

from sunarc.common.findings import Finding
from sunarc.imager.archive.pictures_of_one_time import TWO_PICTURES
from sunarc.imager.cameras.options import FolderOptions
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.status import Reason, StatusRegistry
from sunarc.sources.image_times import TimeRules, parse_utc_offset


def time_rules(options: FolderOptions) -> TimeRules:
    """Return the rules of times of a folder's images; InputError for an unknown zone."""
    offset = None if options.utc_offset is None else parse_utc_offset(options.utc_offset, field="folder.utc_offset")
    return TimeRules(pattern=options.time_pattern, offset=offset, documents=True)


FUTURE = "file_time_future"
DATED_AGAIN = (
    *("file_time_zone", "file_zone_contradicts", "file_time_pattern", "file_time_unknown", "file_time_ambiguous"),
    FUTURE,
)
"""Verdicts that a restart revises: settings or the host's clock may have been corrected."""
_LEFT_OUT_CODES = {
    "file_time_zone": "images_without_zone",
    "file_time_twice": "images_left_out",
    "file_time_unknown": "images_without_time",
    "file_time_ambiguous": "images_without_time",
    "file_time_pattern": "images_without_time",
    "file_time_range": "images_without_time",
    "file_zone_contradicts": "images_without_zone",
    "file_size_differs": "images_of_another_size",
    "file_other_camera": "images_of_two_cameras",
    "file_time_future": "images_in_future",
    TWO_PICTURES: TWO_PICTURES,
}
LEFT_OUT = tuple(dict.fromkeys([*_LEFT_OUT_CODES.values(), "images_left_out"]))
"""Conditions of images that are left out, one at a time."""
_EXPECTED = frozenset({"file_at_night", "file_copy", "file_latest", "frame_repeated"})
"""Of images that are left out with nothing wrong."""
_RECENT, _LEAST, _SHARE = 12, 3, 0.25
"""Of the last images, as many and such a share left out for one reason are a condition."""


class LeftOut:
    """Condition of a folder most of whose last images are left out.

    Parameters
    ----------
    board : where it is set.
    """

    def __init__(self, board: StatusRegistry) -> None:
        self._board = board
        self._last: dict[str, str | None] = {}

    def note(self, file: str, finding: Finding | None) -> None:
        """Count an image that was used (None), or one that was left out, with the finding."""
        if finding is not None and finding.code in _EXPECTED:
            return
        cause = None if finding is None else _LEFT_OUT_CODES.get(finding.code, "images_left_out")
        self._last.pop(file, None)  # one that is tried again counts once
        self._last[file] = cause
        if len(self._last) > _RECENT:
            del self._last[next(iter(self._last))]
        counts = Counter(one for one in self._last.values() if one is not None)
        worst, n = counts.most_common(1)[0] if counts else ("", 0)
        if finding is not None and cause == worst and n >= _LEAST and n >= _SHARE * len(self._last):
            self._board.set_one_condition(LEFT_OUT, _make_reason(worst, n, file, finding))
        elif n < max(_LEAST, _SHARE * len(self._last)):
            self._board.set_one_condition(LEFT_OUT, None)


def _make_reason(code: str, n: int, file: str, finding: Finding) -> Reason:
    if finding.code == code:
        return Reason.of(finding)
    why, remedy = finding.text, finding.remedy
    return Reason.of(Finding(code, {"n": n, "file": file, "why": why, "remedy": remedy}))


_QUARTER_S, _SAME_S = 900.0, 120.0
_LATE_TIME_S, _SPREAD_SHARE = 180.0, 0.2
"""Images come within a minute or two of their exposure; the same lateness of all of them is a clock's."""
_ARRIVAL_CODES = ("image_times_offset", "image_times_late")
_COMPARED = 8


class ArrivalTimes:
    """Comparison of images' stated times with their arrival: a wrong zone shifts by whole quarters of an hour.

    Parameters
    ----------
    board : where the condition is set.
    settle_s : how long a file is not changed before it counts as complete.
    """

    def __init__(self, board: StatusRegistry, *, settle_s: float = 0.0) -> None:
        self._board = board
        self._most_late_s = _LATE_TIME_S + settle_s
        self._late_s: deque[float] = deque(maxlen=_COMPARED)

    def note(self, stated: datetime, came: datetime) -> None:
        """Compare the time of an image with its arrival, where it arrived while the service ran."""
        self._late_s.append((came - stated).total_seconds())
        if len(self._late_s) < _COMPARED:
            return
        late_s = float(np.median(self._late_s))
        spread_s = float(np.max(np.abs(np.array(self._late_s) - late_s)))
        quarters = round(late_s / _QUARTER_S)
        wrong = quarters != 0 and spread_s < _SAME_S and abs(late_s - quarters * _QUARTER_S) < _SAME_S
        found = Finding("image_times_offset", {"hours": quarters / 4.0})
        late = not wrong and late_s > self._most_late_s and spread_s < max(_SAME_S, _SPREAD_SHARE * late_s)
        if late:
            found = Finding("image_times_late", {"late_s": round(late_s)})
        self._board.set_one_condition(_ARRIVAL_CODES, Reason.of(found) if wrong or late else None)


class AheadOfClock:
    """Images whose stated time was ahead of the host's clock, kept until the clock is set forward by as much.

    To wait for such a time proves nothing: with a wrong zone it passes after an hour.

    Parameters
    ----------
    clock : of the host.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._due: dict[str, float] = {}

    def note(self, name: str, ahead_s: float) -> None:
        """Keep the name of an image that is so far ahead of the clock, s."""
        self._due[name] = self._clock_setting_s() + ahead_s

    def passed(self) -> list[str]:
        """Return, once, the images that are not ahead of the clock as it was set since."""
        set_s = self._clock_setting_s()
        names = [name for name, due_s in self._due.items() if set_s >= due_s]
        for name in names:
            del self._due[name]
        return names

    def _clock_setting_s(self) -> float:
        return self._clock.now().timestamp() - self._clock.monotonic()
