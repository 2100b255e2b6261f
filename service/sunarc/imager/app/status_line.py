"""Report of a life of the service: the line of `systemctl status`, and the condition that no frame has come yet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass

from sunarc.common.findings import Finding
from sunarc.imager.runtime.host import Notifier
from sunarc.imager.runtime.status import Reason, StatusRegistry, StatusSnapshot

_LEAST_INTERVAL_S = 10.0  # a line is for people; systemd logs none of it, but each is a message on its bus
_MOST_CODES = 4

NO_FRAME_YET = "no_frame_yet"
"""Code of the condition that is set at the start."""


class FirstFrame:
    """Condition `no_frame_yet`, which holds until a frame has come.

    Parameters
    ----------
    board : which may have the time of the last frame before the start (see `restore_last_known`).
    """

    def __init__(self, board: StatusRegistry) -> None:
        self._board = board
        self._before = board.snapshot().last_frame_at
        board.set_condition(NO_FRAME_YET, Reason.of(Finding(NO_FRAME_YET)), log=False)  # at every start

    def check(self) -> None:
        """Clear the condition once a frame has come since the start."""
        if self._board.snapshot().last_frame_at != self._before:
            self._board.set_condition(NO_FRAME_YET, None, log=False)


@dataclass(eq=False)
class StatusLine:
    """Keeps systemd's status text current; sends it when it has changed, at most every 10 s.

    Parameters
    ----------
    notifier : to whom.
    snapshot : the status board.
    address : where the service answers.
    monotonic : seconds that never jump.
    """

    notifier: Notifier
    _: KW_ONLY
    snapshot: Callable[[], StatusSnapshot]
    address: str
    monotonic: Callable[[], float]

    def __post_init__(self) -> None:
        """Begin with nothing sent."""
        self._sent = ""
        self._sent_at_s: float | None = None

    def ready(self) -> None:
        """Report that the service is up."""
        self._note_sent_text(self.text())
        self.notifier.ready(self._sent)

    def update(self) -> None:
        """Send the line again where it has changed; before `ready`, nothing."""
        if self._sent_at_s is None or self.monotonic() - self._sent_at_s < _LEAST_INTERVAL_S:
            return
        text = self.text()
        if text != self._sent:
            self._note_sent_text(text)
            self.notifier.status(text)

    def text(self) -> str:
        """Return the line as it is now."""
        snapshot = self.snapshot()
        last = snapshot.last_sighting_at
        parts = [
            f"serving at {self.address}",
            snapshot.health.replace("_", " "),
            "no sighting yet" if last is None else f"last sighting {last:%Y-%m-%d %H:%M:%S} UTC",
        ]
        codes = [reason.code for reason in snapshot.reasons]
        if codes:
            more = f" and {len(codes) - _MOST_CODES} more" if len(codes) > _MOST_CODES else ""
            parts.append(f"conditions: {', '.join(codes[:_MOST_CODES])}{more}")
        return "; ".join(parts)

    def _note_sent_text(self, text: str) -> None:
        self._sent, self._sent_at_s = text, self.monotonic()
