"""Tables as a narrow terminal shows them, and what an option says."""

from __future__ import annotations

from io import StringIO

import pytest
from rich.console import Console

from sunarc.cli.options import parse_image_size, table
from sunarc.errors import InputError

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


def test_nothing_and_numbers() -> None:
    out = shown(["a", None, 1.23456, 7, True], width=80)
    assert "1.235" in out
    assert "None" not in out


@pytest.mark.parametrize(("text", "size"), [("1748,1600", (1748, 1600)), (" 1 , 2 ", (1, 2))])
def test_an_image_size_is_width_and_height(text: str, size: tuple[int, int]) -> None:
    assert parse_image_size(text) == size


@pytest.mark.parametrize("text", ["", "8", "8,6,3", "0,6", "8,-6", "8.5,6", "8x6", "nan,6"])
def test_what_is_no_image_size_is_refused(text: str) -> None:
    with pytest.raises(InputError) as refused:
        parse_image_size(text)
    assert refused.value.field == "--image-size"
