"""Logging to systemd's journal or standard error: one event a line, repeats suppressed.

Under systemd the lines go to the journal by its native protocol, with fields of their own (`SUNARC_EVENT` and
`SUNARC_KIND` are those of `/v1/events`, `SUNARC_STACK` is an exception's); elsewhere they go to standard error.

Levels: debug, for developers; info, what went as it should; warning, what was lost and is tried again; error, what an
operator has to act; critical, an error that ends the service.
"""

from __future__ import annotations

import logging
import os
import re
import socket
import sys
from collections.abc import Mapping
from pathlib import Path

_SOCKET = Path("/run/systemd/journal/socket")
_FIELDS = {"event_id": "SUNARC_EVENT", "event_kind": "SUNARC_KIND"}
_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
_QUIET_LIBRARIES = ("apscheduler", "alembic", "uvicorn.access", "matplotlib", "PIL")


def start_log(environment: Mapping[str, str]) -> None:
    """Send the process's log to the journal where standard error is one, else to standard error."""
    handler: logging.Handler = logging.StreamHandler()
    if stands_in_journal(environment, descriptor=sys.stderr.fileno()):
        handler = JournalHandler(_SOCKET)
    handler.setFormatter(_OneLine("%(levelname)s %(name)s: %(message)s"))
    handler.addFilter(Repeats())
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    for name in _QUIET_LIBRARIES:
        logging.getLogger(name).setLevel(logging.WARNING)


def stands_in_journal(environment: Mapping[str, str], *, descriptor: int) -> bool:
    """Return whether a file descriptor is the stream of systemd to this process (systemd.exec(5), JOURNAL_STREAM)."""
    try:
        file = os.fstat(descriptor)
    except OSError:
        return False
    return environment.get("JOURNAL_STREAM") == f"{file.st_dev}:{file.st_ino}"


class JournalHandler(logging.Handler):
    """Sends records to systemd's journal with their fields (its native protocol); when that fails, to standard error.

    Parameters
    ----------
    path : the journal's datagram socket.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path
        self._outlet = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)

    def emit(self, record: logging.LogRecord) -> None:
        """Send one record; never raises."""
        fields = journal_fields(record)
        try:
            self._outlet.sendto(
                b"".join(_encode_field(name, text) for name, text in fields.items()), os.fspath(self._path)
            )
        except OSError:  # longer than a datagram, or nobody there: systemd reads the level off the line
            sys.stderr.write(f"<{fields['PRIORITY']}>{fields['MESSAGE']}\n")

    def close(self) -> None:
        """Close the socket."""
        self._outlet.close()
        super().close()


class Repeats(logging.Filter):
    """Passes the first few of equal records, then one a window with the number of those suppressed.

    Records are alike when logger, level and text are, numbers in it aside.

    Parameters
    ----------
    allowed, window_s : how many pass within how many seconds.
    """

    def __init__(self, *, allowed: int = 5, window_s: float = 300.0) -> None:
        super().__init__()
        self._allowed = allowed
        self._window_s = window_s
        self._windows: dict[tuple[str, int, str], _Window] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Decide on one record by its own time."""
        key = (record.name, record.levelno, re.sub(r"\d+(\.\d+)?", "#", record.getMessage()))
        window = self._windows.get(key)
        if window is None or not 0.0 <= record.created - window.since < self._window_s:
            held_back = window.held_back if window else 0
            self._forget_old_windows(record.created)
            self._windows[key] = _Window(record.created)
            if held_back:
                record.msg, record.args = f"{record.getMessage()} ({held_back} more like this before)", None
            return True
        window.passed += 1
        window.held_back += window.passed > self._allowed
        return window.passed <= self._allowed

    def _forget_old_windows(self, now: float) -> None:
        """Keep the record of messages from growing; a window that held something back waits for its next."""
        for key, window in list(self._windows.items()):
            # A negative age is that of a window from before the clock was set back: it would never grow old.
            age = now - window.since
            if (age > self._window_s and not window.held_back) or abs(age) > 12.0 * self._window_s:
                del self._windows[key]


class _Window:
    """Count of a message since a time."""

    def __init__(self, since: float) -> None:
        self.since = since
        self.passed = 1
        self.held_back = 0


class _OneLine(logging.Formatter):
    """A record on a line of its own; only an exception's stack follows it."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - the library's name
        record.message = _join_lines(record.message)
        return super().formatMessage(record)


def journal_fields(record: logging.LogRecord) -> dict[str, str]:
    """Return a record as the journal's fields; the message is one line, the stack stands in a field of its own."""
    message = _join_lines(record.getMessage())
    fields = {
        "PRIORITY": str(_journal_priority(record.levelno)),
        "LOGGER": record.name,
        "THREAD_NAME": record.threadName or "",
    }
    if record.exc_info and record.exc_info[0] is not None:
        message = f"{message}: {record.exc_info[0].__name__}: {_join_lines(str(record.exc_info[1]))}"
        fields["SUNARC_STACK"] = logging.Formatter().formatException(record.exc_info)
    for attribute, name in _FIELDS.items():
        if hasattr(record, attribute):
            fields[name] = str(getattr(record, attribute))
    return {"MESSAGE": message, "SYSLOG_IDENTIFIER": "sunarc", **fields}


def _encode_field(name: str, text: str) -> bytes:
    value = text.encode()
    # The journal's native protocol: a value with a line break follows its length, 64 bits, little-endian.
    if b"\n" in value:
        return name.encode() + b"\n" + len(value).to_bytes(8, "little") + value + b"\n"
    return name.encode() + b"=" + value + b"\n"


def _journal_priority(level: int) -> int:
    return next((priority for least, priority in _PRIORITIES if level >= least), 7)


def _join_lines(text: str) -> str:
    return " ".join(text.split())
