"""Options that several commands share, and their output: JSON, tables, progress bars."""

from __future__ import annotations

import shutil
import sys
import textwrap
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO, TypeVar

import typer

from sunarc.cli.owner import act_as_owner
from sunarc.common.errors import InputError
from sunarc.common.json_text import json_text
from sunarc.common.utc import DAY_S
from sunarc.imager.runtime.clock import SystemClock
from sunarc.sky.site import parse_angle
from sunarc.sources.time_patterns import checked_pattern

if TYPE_CHECKING:
    from rich.table import Table

    from sunarc.imager.settings.model import HubSettings, Settings

SITE = "Where the camera stands"
"""Heading of the site's options in `--help`."""

Config = Annotated[
    Path | None, typer.Option("--config", envvar="SUNARC_CONFIG", help="Settings file (TOML).", show_default=False)
]

State = Annotated[Path, typer.Option("--state", callback=act_as_owner, help="The service's state folder.")]
OptionalState = Annotated[
    Path | None, typer.Option("--state", callback=act_as_owner, help="The service's state folder.", show_default=False)
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
TIME_PATTERN_HELP = "Pattern of the names without suffix, as %Y%m%d_%H%M%S, img_%s or %Y/%m/%d/%H%M%S."


def _check_pattern(given: str | None) -> str | None:
    return None if given is None else checked_pattern(given, field="--time-pattern")


TimePatternOption = Annotated[
    str | None, typer.Option("--time-pattern", callback=_check_pattern, help=TIME_PATTERN_HELP)
]
_LATITUDE = typer.Option(
    "--latitude", metavar="ANGLE", help="Degrees, north positive, or as 47°25'12\"N.", rich_help_panel=SITE
)
_LONGITUDE = typer.Option(
    "--longitude", metavar="ANGLE", help="Degrees, east positive, or as 8°33'E.", rich_help_panel=SITE
)
Latitude = Annotated[str, _LATITUDE]
Longitude = Annotated[str, _LONGITUDE]
LatitudeIfGiven = Annotated[str | None, _LATITUDE]
LongitudeIfGiven = Annotated[str | None, _LONGITUDE]
Altitude = Annotated[float, typer.Option(help="Metres above sea level.", rich_help_panel=SITE)]
CalibrationFile = Annotated[Path, typer.Option("--calibration", help="A calibration document (JSON).")]
AcceptRefused = Annotated[bool, typer.Option("--accept-refused", help="Answer by a refused calibration, too.")]
DetectionMethod = Annotated[str, typer.Option("--method", help="auto, disc (microsecond frames) or paper (ordinary).")]

LevelWithin = Annotated[
    float | None,
    typer.Option(
        help="Largest tilt of the camera, degrees. Unless given, a first fit that is tilted by more than 5 is "
        "refused: a wrong site or clock looks the same.",
    ),
]
ClockError = Annotated[
    float | None,
    typer.Option(
        help="Bound of the clock's error, seconds, which the stated uncertainty then holds; unless given, 2 s are "
        "assumed.",
        min=0.0,
        max=DAY_S,
    ),
]
OutwardsPx = Annotated[
    float | None,
    typer.Option(
        help="1-sigma of how far the sun is detected from its place along the radius, px, which the stated uncertainty "
        "holds; 0.07 unless given.",
        min=0.0,
        max=10.0,
        show_default=False,
    ),
]
FollowExif = Annotated[
    bool,
    typer.Option("--follow-exif", help="Turn pictures as their EXIF orientation states; else they are as stored."),
]
ProjectionOption = Annotated[
    list[str] | None,
    typer.Option(
        "--projection",
        metavar="TEXT",
        help="The lens's ideal projection; unless given, the one that the sightings make most probable.",
    ),
]
MirroredOption = Annotated[
    list[str] | None,
    typer.Option(
        "--mirrored",
        metavar="TEXT",
        help="Whether the images are mirror images: no, yes, auto. Unless given they are not, and a fit is refused "
        "where they may be.",
    ),
]


def service_settings(config: Path | None) -> Settings:
    """Return the settings of a service, as whose user the command acts from then on."""
    from sunarc.imager.settings.load import load_settings

    settings = load_settings(config)
    act_as_owner(settings.state)
    return settings


def hub_settings(config: Path | None) -> HubSettings:
    """Return the settings of a hub; where its archive is a file, the command acts as the file's user from then on."""
    from sunarc.imager.settings.load import load_hub_settings

    settings = load_hub_settings(config)
    act_as_owner(settings.state if settings.store is None else None)
    return settings


def parse_angles(latitude: str | None, longitude: str | None) -> tuple[float | None, float | None]:
    """Return latitude and longitude in degrees, None where not given; InputError where one is no such angle."""
    return (
        None if latitude is None else parse_angle(latitude, question="--latitude", axis="NS"),
        None if longitude is None else parse_angle(longitude, question="--longitude", axis="EW"),
    )


Choice = TypeVar("Choice", bound=str)


def stated_once(option: str, given: Sequence[str] | None, choices: tuple[Choice, ...]) -> Choice | None:
    """Return the choice that an option names, None where it is not given; InputError where it is given twice."""
    if not given:
        return None
    if len(given) > 1:
        raise InputError(field=option, problem=f"given twice: {', '.join(given)}", remedy="give it once")
    return parse_choice(option, given[0], choices)


def parse_choice(option: str, text: str, choices: tuple[Choice, ...]) -> Choice:
    """Return the choice that an option's text names; InputError where it names none."""
    for choice in choices:
        if text == choice:
            return choice
    raise InputError(field=option, problem=f"{text!r} is unknown", remedy=f"use one of {', '.join(choices)}")


_NAME_CHARACTERS = 40  # half of a terminal's usual width


def print_json(value: Any) -> None:  # noqa: ANN401 - whatever JSON holds
    """Print a value as JSON; NaN is a bug."""
    print(json_text(value), end="")


def table(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> Table:
    """Return a table; None is an empty cell, a float has three places.

    The first column names a row; where the names are short (ids), a narrow terminal breaks the other columns first.
    """
    from rich.table import Table

    cells = [
        ["" if cell is None else f"{cell:.3f}" if isinstance(cell, float) else str(cell) for cell in row]
        for row in rows
    ]
    made = Table(*columns, show_header=any(columns))
    for column in made.columns:
        column.overflow = "fold"  # a narrow terminal breaks a cell, and cuts none
    if columns and max((len(row[0]) for row in cells), default=0) <= _NAME_CHARACTERS:
        made.columns[0].no_wrap = True
        made.columns[0].overflow = "ignore"
    for row in cells:
        made.add_row(*row)
    return made


def print_rows(value: Any, columns: Sequence[str], rows: Iterable[Sequence[Any]], *, as_json: bool) -> None:  # noqa: ANN401 - whatever JSON holds
    """Print a value as JSON, or the table of it."""
    if as_json:
        print_json(value)
    else:
        print_table(columns, rows)


def print_text(value: Any, text: str, *, as_json: bool) -> None:  # noqa: ANN401 - whatever JSON holds
    """Print a value as JSON, or the text that says it."""
    if as_json:
        print_json(value)
    else:
        print(text)


def print_table(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Print a table; see `table`."""
    from rich.console import Console

    Console(soft_wrap=True).print(table(columns, rows))


def print_sentence(text: str, *, file: TextIO | None = None) -> None:
    """Print a line; on a terminal it is broken between words, names of files stay whole."""
    out = file or sys.stdout
    if not out.isatty():
        print(text, file=out)
        return
    width = shutil.get_terminal_size().columns
    print(_BETWEEN_WORDS(width=width).fill(text), file=out)


_BETWEEN_WORDS = partial(textwrap.TextWrapper, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)
_LINE_S = 60.0
"""Between lines of progress where there is no terminal."""


@contextmanager
def progress_bars(*, every_s: float = _LINE_S) -> Iterator[Callable[[str, int, int], None]]:
    """Give the function that draws a bar for each stage; a line a minute where standard error is no terminal."""
    if not sys.stderr.isatty():
        with _progress_lines(every_s) as note:
            yield note
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = Console(stderr=True, soft_wrap=True)
    with Progress(*columns, console=console) as bars:
        tasks = {}

        def update(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield update


@contextmanager
def _progress_lines(every_s: float) -> Iterator[Callable[[str, int, int], None]]:
    """Give the function that notes how far a stage is; a thread writes the latest note, also while a stage lasts."""
    ended, latest, clock = threading.Event(), ["beginning"], SystemClock()

    def note(stage: str, done: int, total: int) -> None:
        latest[0] = f"{stage}: {done} of {total}"

    def write() -> None:
        while not clock.wait(ended, every_s):
            print(latest[0], file=sys.stderr, flush=True)

    writer = threading.Thread(target=write, name="progress", daemon=True)
    writer.start()
    try:
        yield note
    finally:
        ended.set()
        writer.join(timeout=1.0)


def parse_image_size(text: str) -> tuple[int, int]:
    """Return width and height in px from "W,H"."""
    try:
        width, height = (int(part) for part in text.split(","))
    except ValueError:
        width = height = 0
    if min(width, height) < 1:
        raise InputError(
            field="--image-size", problem=f"{text!r} is not W,H", remedy="give two whole numbers, as 1748,1748"
        )
    return width, height
