"""What a hub does once a night: its jobs, one after the other, each tried again when it failed."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Annotated, Any

from annotated_types import Ge, Le

from sunarc.archive.archive import Archive
from sunarc.archive.nightly import LEAST_KEPT, NightlyRun
from sunarc.bounds import require_bounds
from sunarc.runtime.clock import Clock
from sunarc.runtime.status import StatusRegistry
from sunarc.sky.days import solar_date
from sunarc.workers.messages import condition
from sunarc.workers.neighbours import cross_check_fleet

_log = logging.getLogger(__name__)
_AFTER_MIDNIGHT = timedelta(hours=2)
"""Of the fleet's mean longitude: imagers judge a day within minutes of its end."""
_TRY_AGAIN = timedelta(hours=1)
_FAILED = "nightly_failed"

Job = Callable[[datetime], Mapping[str, Any]]
"""Does what is due at a time, and returns what it did, in JSON; done twice, it changes nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NightlyOptions:
    """What a hub does once a night.

    Attributes
    ----------
    keep_sightings_days : sightings of months that ended longer ago are removed from a hub's archive.
    """

    keep_sightings_days: Annotated[float, Ge(LEAST_KEPT / timedelta(days=1)), Le(36_500.0)] = 36_500.0

    def __post_init__(self) -> None:
        """Refuse what would remove what is needed."""
        require_bounds(self, section="nightly")


def nightly_jobs(archive: Archive, options: NightlyOptions) -> dict[str, Job]:
    """Return the jobs of a hub by name, in their order.

    Parameters
    ----------
    archive : the hub's.
    options : how long sightings are kept.
    """
    keep = timedelta(days=options.keep_sightings_days)
    return {
        "summaries": lambda _now: {"days": archive.summarise_days()},
        "cross_checks": lambda now: {"checks": [one.as_json() for one in cross_check_fleet(archive, now=now)]},
        "retention": lambda now: {"removed": archive.remove_sightings(before=now - keep, now=now)},
    }


class NightlyWork:
    """Runs the jobs of a night when they are due, and remembers in the archive how they went.

    A night is a solar date at the fleet's mean longitude. It is due from 2 h after midnight on until all its jobs
    succeeded; a job that failed, or was cut off, is tried again after an hour. Nights that were missed are made up by
    one, since jobs do whatever is due.

    Parameters
    ----------
    archive : the hub's.
    jobs : by name, in their order.
    clock : real time.
    board : where a failure is shown.
    """

    def __init__(self, *, archive: Archive, jobs: Mapping[str, Job], clock: Clock, board: StatusRegistry) -> None:
        self._archive, self._jobs, self._clock, self._board = archive, jobs, clock, board

    def run_due(self) -> None:
        """Run what is due; to be called every minute."""
        now = self._clock.now()
        unix_s = (now - _AFTER_MIDNIGHT).timestamp()
        night = solar_date(unix_s, longitude=self._archive.mean_longitude())
        last = next(iter(self._archive.nightly_runs(limit=1, until=night)), None)
        if last is not None and last.night == night:
            done = last.finished_at is not None and not last.failed
            if done or timedelta(0) <= now - last.started_at < _TRY_AGAIN:
                self._show(last)
                return
        succeeded = {} if last is None or last.night != night else last.results
        run = NightlyRun(night=night, started_at=now, results=_without_errors(succeeded))
        self._archive.save_nightly(run)
        for name, job in self._jobs.items():
            if name not in run.results:
                run = replace(run, results={**run.results, name: self._result(name, job)})
        run = replace(run, finished_at=self._clock.now())
        self._archive.save_nightly(run)
        self._show(run)

    def _result(self, name: str, job: Job) -> Mapping[str, Any]:
        try:
            result = job(self._clock.now())
        except Exception as error:  # noqa: BLE001 - one job that fails must not keep the others from their work
            _log.exception("the nightly job %s failed", name)
            return {"error": f"{type(error).__name__}: {error}"}
        _log.info("nightly job %s: %s", name, dict(result))
        return result

    def _show(self, run: NightlyRun) -> None:
        reason = None
        if run.failed:
            jobs, error = ", ".join(run.failed), next(iter(run.failed.values()))
            reason = condition(_FAILED, night=run.night.isoformat(), jobs=jobs, error=error)
        self._board.set_condition(_FAILED, reason)


def _without_errors(results: Mapping[str, Any]) -> dict[str, Any]:
    return {name: result for name, result in results.items() if "error" not in result}
