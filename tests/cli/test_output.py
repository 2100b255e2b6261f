"""Tables as a narrow terminal shows them, and what an option says."""

from __future__ import annotations

import sys
import threading
from io import StringIO

import pytest
from rich.console import Console

from sunarc.cli.options import parse_image_size, print_sentence, progress_bars, table
from sunarc.common.errors import InputError
from sunarc.imager.runtime.clock import SystemClock

ID = "20130514T063000Z-ab12cd"


def shown(*rows: list[object], width: int) -> str:
    out = StringIO()
    Console(file=out, width=width, soft_wrap=True).print(table(("id", "state", "from", "until", "1-sigma"), rows))
    return out.getvalue()


def test_an_id_is_never_cut() -> None:
    row: list[object] = [ID, "superseded", "2013-05-14 06:30", "2013-05-15 06:30", "0.0031°"]
    for width in (50, 60, 80, 200):
        assert ID in shown(row, width=width)


def test_a_narrow_terminal_cuts_no_cell() -> None:
    row: list[object] = ["roof", "moved", "2023-05-13T18:00\n2023-06-01T09:30", "+3600", "0.0031°"]
    out = "".join(shown(row, width=50).split())
    assert "…" not in out
    for part in ("+3600", "moved"):
        assert part in out


def test_a_long_name_leaves_room_for_the_other_columns() -> None:
    row: list[object] = ["/srv/images/2013/05/14/" + 80 * "x" + ".png", "clear", "a", "b", 0.25]
    assert "clear" in shown(row, width=80)


def test_a_sentence_is_broken_between_words_on_a_terminal_and_whole_in_a_pipe(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setenv("COLUMNS", "80")
    path = "/srv/images/" + 90 * "x" + ".png"
    text = f"left out {path}: " + "its well-known name is read as 2013-06-05T12:30:00; give --time-pattern " * 3
    terminal, pipe = Terminal(), StringIO()
    print_sentence(text, file=terminal)
    print_sentence(text, file=pipe)
    lines = terminal.getvalue().splitlines()
    assert max(len(line) for line in lines if path not in line) <= 80
    assert " ".join(terminal.getvalue().split()) == text.strip()
    assert pipe.getvalue() == text + "\n"


def test_nothing_and_numbers() -> None:
    out = shown(["a", None, 1.23456, 7, True], width=80)
    assert "1.235" in out
    assert "None" not in out


def test_a_table_of_epochs_is_whole_on_80_columns() -> None:
    columns = ("epoch", "cause", "from, to", "clock\ns", "suns", "RMSE\npx", "sky\n°", "ok")
    row = ("roof-west 001", "moved", "2024-05-10T06:34\n2024-05-12T15:06", "+3600", 12345, "0.14", "0.15", "yes")
    out = StringIO()
    Console(file=out, width=80, soft_wrap=True).print(table(columns, [row]))
    lines = out.getvalue().splitlines()
    assert max(map(len, lines)) <= 80
    assert len(lines) == 7  # no cell is broken
    assert "2024-05-10T06:34" in lines[4]


def test_without_a_terminal_the_latest_progress_is_a_line_at_an_interval(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: False)
    with progress_bars(every_s=0.02) as note:
        note("searching", 64, 500)
        note("searching", 128, 500)
        SystemClock().wait(threading.Event(), 0.3)
    lines = capsys.readouterr().err.splitlines()
    assert lines.count("searching: 128 of 500") >= 2
    assert "searching: 64 of 500" not in lines
    with progress_bars(every_s=60.0) as note:
        note("searching", 1, 2)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("text", "size"), [("1748,1600", (1748, 1600)), (" 1 , 2 ", (1, 2))])
def test_an_image_size_is_width_and_height(text: str, size: tuple[int, int]) -> None:
    assert parse_image_size(text) == size


@pytest.mark.parametrize("text", ["", "8", "8,6,3", "0,6", "8,-6", "8.5,6", "8x6", "nan,6"])
def test_what_is_no_image_size_is_refused(text: str) -> None:
    with pytest.raises(InputError) as refused:
        parse_image_size(text)
    assert refused.value.field == "--image-size"
