"""What reaches the journal: read back from the socket that systemd would listen at."""

from __future__ import annotations

import logging
import os
import re
import socket
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from sunarc.imager.runtime.log_to_journal import JournalHandler, Repeats, journal_fields, stands_in_journal, start_log


class Journal:
    """Listens where systemd's journal would, and reads its native protocol."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._socket.settimeout(5.0)

    def read(self) -> dict[str, str]:
        data, fields = self._socket.recv(1 << 20), {}
        while data:
            line, _, data = data.partition(b"\n")
            name, equals, value = line.partition(b"=")
            if not equals:
                size = int.from_bytes(data[:8], "little")
                value, data = data[8 : 8 + size], data[9 + size :]
            fields[name.decode()] = value.decode()
        return fields

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def journal() -> Iterator[Journal]:
    with tempfile.TemporaryDirectory() as folder:  # a socket's name is short
        journal = Journal(Path(folder, "socket"))
        yield journal
        journal.close()


@pytest.fixture
def log(journal: Journal) -> Iterator[logging.Logger]:
    logger = logging.getLogger("sunarc.test_journal")
    handler = JournalHandler(journal.path)
    logger.addHandler(handler)
    logger.propagate = False
    logger.setLevel(logging.DEBUG)
    yield logger
    logger.removeHandler(handler)
    handler.close()


def record(text: str, *, at: float = 0.0, level: int = logging.WARNING, name: str = "sunarc.x") -> logging.LogRecord:
    made = logging.LogRecord(name, level, __file__, 1, text, None, None)
    made.created = at
    return made


@pytest.mark.parametrize(
    ("level", "priority"), [(logging.DEBUG, "7"), (logging.INFO, "6"), (logging.ERROR, "3"), (logging.CRITICAL, "2")]
)
def test_a_record_arrives_with_its_priority_and_logger(
    log: logging.Logger, journal: Journal, level: int, priority: str
) -> None:
    log.log(level, "exposure: %g", 12.0)
    fields = journal.read()
    assert fields["MESSAGE"] == "exposure: 12"
    assert (fields["PRIORITY"], fields["LOGGER"], fields["SYSLOG_IDENTIFIER"]) == (
        priority,
        "sunarc.test_journal",
        "sunarc",
    )


def test_an_event_carries_its_id_so_that_the_api_tells_the_same(log: logging.Logger, journal: Journal) -> None:
    log.warning("the camera was bumped", extra={"event_id": 17, "event_kind": "bump"})
    fields = journal.read()
    assert (fields["SUNARC_EVENT"], fields["SUNARC_KIND"]) == ("17", "bump")


def test_a_message_is_one_line_and_an_exceptions_stack_a_field_of_its_own(
    log: logging.Logger, journal: Journal
) -> None:
    try:
        int("two\nlines")
    except ValueError:
        log.exception("detect died\nat noon")
    fields = journal.read()
    message, kind, cause = fields["MESSAGE"].split(": ", maxsplit=2)
    assert (message.split(), kind) == (["detect", "died", "at", "noon"], "ValueError")
    assert cause.endswith(r"'two\nlines'")
    assert fields["SUNARC_STACK"].startswith("Traceback (most recent call last):\n")


def test_a_text_cannot_forge_a_field(log: logging.Logger, journal: Journal) -> None:
    log.info("a camera's name\nPRIORITY=0\nSUNARC_EVENT=1")
    fields = journal.read()
    assert fields["PRIORITY"] == "6"
    assert "SUNARC_EVENT" not in fields


def test_without_a_journal_the_line_goes_to_standard_error(
    log: logging.Logger, journal: Journal, capsys: pytest.CaptureFixture[str]
) -> None:
    journal.close()
    log.error("disk full")
    assert capsys.readouterr().err == "<3>disk full\n"


def test_repeats_are_held_back_and_counted() -> None:
    repeats = Repeats(allowed=3, window_s=60.0)
    passed = [at for at in range(50) if repeats.filter(record(f"exposure {at} of 12.5 us failed", at=float(at)))]
    assert passed == [0, 1, 2]
    following = record("exposure 51 of 3 us failed", at=61.0)
    assert repeats.filter(following)
    assert following.getMessage().startswith("exposure 51")
    assert re.findall(r"\d+", following.getMessage())[-1] == "47"


def test_another_logger_level_or_text_is_no_repeat() -> None:
    repeats = Repeats(allowed=1, window_s=60.0)
    assert repeats.filter(record("camera lost"))
    assert not repeats.filter(record("camera lost"))
    assert repeats.filter(record("camera lost", level=logging.ERROR))
    assert repeats.filter(record("camera lost", name="sunarc.y"))
    assert repeats.filter(record("camera found"))


def test_a_clock_set_back_does_not_silence_the_log() -> None:
    repeats = Repeats(allowed=1, window_s=60.0)
    assert repeats.filter(record("camera lost", at=1e6))
    assert repeats.filter(record("camera lost", at=10.0))


def test_what_was_said_once_is_forgotten() -> None:
    repeats = Repeats(allowed=1, window_s=60.0)
    for at in range(10_000):
        repeats.filter(record(f"name {chr(65 + at % 26)}{chr(65 + at // 26 % 26)}{chr(65 + at // 676)}", at=at * 10.0))
    assert len(repeats._windows) < 20


def test_only_the_stream_that_systemd_gave_is_the_journal(tmp_path: Path) -> None:
    with (tmp_path / "stream").open("w") as stream:
        file = os.fstat(stream.fileno())
        assert stands_in_journal({"JOURNAL_STREAM": f"{file.st_dev}:{file.st_ino}"}, descriptor=stream.fileno())
        assert not stands_in_journal({"JOURNAL_STREAM": f"{file.st_dev}:1"}, descriptor=stream.fileno())
        assert not stands_in_journal({}, descriptor=stream.fileno())
    assert not stands_in_journal({"JOURNAL_STREAM": "1:1"}, descriptor=-1)


def test_elsewhere_the_log_is_a_line_a_record_on_standard_error(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    root = logging.getLogger()
    before, level = root.handlers[:], root.level
    with (tmp_path / "err").open("w+") as error:
        monkeypatch.setattr(sys, "stderr", error)
        try:
            start_log({})
            logging.getLogger("sunarc.x").info("ready\nnow")
        finally:
            root.handlers[:] = before
            root.setLevel(level)
        error.seek(0)
        assert error.read().split() == ["INFO", "sunarc.x:", "ready", "now"]


def test_no_field_is_left_out_for_want_of_a_thread() -> None:
    made = record("text")
    made.threadName = None
    assert journal_fields(made)["THREAD_NAME"] == ""
