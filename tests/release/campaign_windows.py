"""Windows of a campaign: faults that overlap, recovery, all invariants; faults that failed together are done singly."""

from __future__ import annotations

import contextlib
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from .campaign_faults import Faults
from .campaign_judge import Findings
from .campaign_processes import now

_MOST_DONE_SINGLY = 6
"""Windows whose faults are done once more, each by itself: a chain that has failed for good ends too."""


@dataclass(kw_only=True)
class Window:
    """Faults that overlapped, and what was found after them.

    Attributes
    ----------
    number : counted from 1.
    faults : in the order drawn.
    took_s : real seconds of the faults.
    recovered_s : real seconds from their end until all went on.
    found : what was found wrong after them and not before.
    singly : the same of each fault by itself, where it was done once more.
    """

    number: int
    faults: list[str]
    took_s: float = 0.0
    recovered_s: float = 0.0
    found: list[str] = field(default_factory=list)
    singly: dict[str, list[str]] = field(default_factory=dict)


class Windows:
    """Runs the windows of one source, and keeps its report up to date.

    Parameters
    ----------
    run : started.
    about : what the report begins with.
    """

    def __init__(self, run: Faults, about: dict[str, Any]) -> None:
        self._run = run
        self._about = about
        self._began = now()
        self._drawn = run.windows()
        self._known: set[str] = set()
        self.done: list[Window] = []
        self.not_recovered: list[str] = []
        self.singly: Counter[str] = Counter()

    def one(self) -> None:
        """Do a window; where something is found wrong after it, its faults each by itself."""
        window = Window(number=len(self.done) + 1, faults=next(self._drawn))
        self.done.append(window)
        self._do(window)
        if window.found and len([one for one in self.done if one.found]) <= _MOST_DONE_SINGLY:
            counts = dict(self._run.counts)
            for fault in window.faults:
                single = Window(number=window.number, faults=[fault])
                self._do(single)
                window.singly[fault] = single.found
            self.singly.update(window.faults)
            self._run.counts = counts
        self.report()

    def _do(self, window: Window) -> None:
        run, began = self._run, now()
        run.disturb(window.faults)
        window.took_s = round(now() - began, 1)
        missing, ended = run.recover(), now()
        window.recovered_s = round(ended - began - window.took_s, 1)
        self.not_recovered += [f"window {window.number}: {text}" for text in missing]
        if missing:
            run.restore()
        window.found = sorted(set(self.check().wrong) - self._known)
        self._known |= set(window.found)
        run.note(f"window {window.number}: {window.took_s:.0f} s, {window.recovered_s:.0f} s, {window.found}")

    def check(self, *, forgotten: Sequence[str] = ()) -> Findings:
        """Return what was found until now."""
        run = self._run
        assert run.judge is not None
        found = run.judge.check()
        found.own_exits, found.left_out, found.not_recovered = run.exits, run.left_out, self.not_recovered
        found.forgotten, found.flipped = list(forgotten), sorted(run.flipped)
        found.n_starts, found.n_starts_again = run.n_starts, run.n_starts_again
        if run.hub is not None:
            with contextlib.suppress(AssertionError):  # PostgreSQL is away, which was found wrong
                found.n_of_hub = run.hub.n_rows
            found.installations = len(run.hub.installations)
        return found

    def report(self, *, ended: bool = False) -> None:
        """Write what is known until now to `report.json`."""
        assert self._run.judge is not None
        found = self._run.judge.found
        report = {
            **self._about,
            "faults": self._run.counts,
            "windows": len(self.done),
            "hours": round((now() - self._began) / 3600.0, 3),
            "recovered_s": sorted(one.recovered_s for one in self.done),
            **asdict(found),
            "failed": [asdict(one) for one in self.done if one.found],
            "singly": dict(self.singly),
            "ended": ended,
            "good": found.good,
        }
        partial = self._run.folder / "report.part"
        partial.write_text(json.dumps(report, indent=1) + "\n")
        partial.replace(self._run.folder / "report.json")
