"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeVar

import typer

from sunarc.errors import InputError

SITE = "Where the camera stands"
"""Heading of the site's options in `--help`."""

Config = Annotated[
    Path | None, typer.Option("--config", envvar="SUNARC_CONFIG", help="Settings file (TOML).", show_default=False)
]
State = Annotated[Path, typer.Option("--state", help="The service's state folder.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Latitude = Annotated[float, typer.Option(help="Degrees, north positive.", rich_help_panel=SITE)]
Longitude = Annotated[float, typer.Option(help="Degrees, east positive.", rich_help_panel=SITE)]
Altitude = Annotated[float, typer.Option(help="Metres above sea level.", rich_help_panel=SITE)]
CalibrationFile = Annotated[Path, typer.Option("--calibration", help="A calibration document (JSON).")]
DetectionMethod = Annotated[str, typer.Option("--method", help="auto, disc (microsecond frames) or paper (ordinary).")]

Choice = TypeVar("Choice", bound=str)


def choice_of(option: str, text: str, choices: tuple[Choice, ...]) -> Choice:
    """Return the choice that an option's text names; InputError where it names none."""
    for choice in choices:
        if text == choice:
            return choice
    raise InputError(field=option, problem=f"{text!r} is unknown", remedy=f"use one of {', '.join(choices)}")
