"""The file of `--cameras`: which files are whose, and where each camera stands.

::

    [cameras.roof]
    sources = ["roof.zip"]      # folders or archives, beside this file; those of the command line where left out
    files = "ccd1_*"            # names of files, as fnmatch has them; all where left out
    utc_offset = -5             # hours ahead of UTC, or a zone as "Europe/Berlin"
    time_pattern = "…"          # strptime
    latitude = 36.6             # of the command line where left out; so are longitude and altitude
    image_size = [1748, 1748]
    mirrored = "no"             # yes, auto
    method = "auto"             # disc, paper
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from sunarc.errors import InputError
from sunarc.offline.files import read_file
from sunarc.offline.image_names import utc_offset_of
from sunarc.offline.reanalysis.plan import CameraPlan, Selector
from sunarc.offline.sources.times import TimeRules

_NUMBERS = ("latitude", "longitude", "altitude")
_KEYS = {"sources", "files", "utc_offset", "time_pattern", *_NUMBERS, "image_size", "mirrored", "method"}


def read_cameras(path: Path, *, common: CameraPlan) -> list[CameraPlan]:
    """Return the cameras of a file; what it leaves out is that of the command line.

    Raises
    ------
    InputError : it is no TOML, names no camera, or something that a camera does not have.
    """
    try:
        tables = tomllib.loads(read_file(path).decode()).get("cameras", {})
    except (ValueError, AttributeError) as error:
        raise InputError(field=str(path), problem=f"is no TOML ({error})", remedy="correct it") from None
    if not isinstance(tables, dict) or not tables:
        raise InputError(field=str(path), problem="names no camera", remedy="give a table [cameras.NAME] for each")
    return [_plan(name, table, common, path) for name, table in tables.items()]


def _plan(name: str, table: object, common: CameraPlan, path: Path) -> CameraPlan:
    where = f"{path.name}, cameras.{name}"
    if not isinstance(table, dict) or set(table) - _KEYS:
        unknown = sorted(set(table) - _KEYS) if isinstance(table, dict) else [str(table)]
        problem, remedy = f"{', '.join(unknown)} is unknown", f"use {', '.join(sorted(_KEYS))}"
        raise InputError(field=where, problem=problem, remedy=remedy)
    if not name or "/" in name or name.startswith("."):
        raise InputError(field=where, problem="is no name for a folder", remedy="use letters, numbers and -")
    try:
        return _filled(name, table, common, path.parent)
    except (TypeError, ValueError) as error:
        raise InputError(field=where, problem=str(error), remedy="correct it") from None


def _filled(name: str, table: Mapping[str, Any], common: CameraPlan, folder: Path) -> CameraPlan:
    sources = _get(table, "sources", lambda given: _sources(given, folder), common.selector.sources)
    rules = TimeRules(
        pattern=_get(table, "time_pattern", str, common.rules.pattern),
        offset=_get(table, "utc_offset", lambda given: utc_offset_of(given, field="utc_offset"), common.rules.offset),
    )
    site = replace(common.site, **{key: float(table[key]) for key in _NUMBERS if key in table})
    return replace(
        common,
        name=name,
        site=site,
        selector=Selector(sources, str(table.get("files", "*"))),
        rules=rules,
        image_size=_get(table, "image_size", _size, common.image_size),
        method=_get(table, "method", _one_of("auto", "disc", "paper"), common.method),
        options=replace(
            common.options, mirrored=_get(table, "mirrored", _one_of("no", "yes", "auto"), common.options.mirrored)
        ),
    )


def _get(table: Mapping[str, Any], key: str, convert: Callable[[Any], Any], default: Any) -> Any:  # noqa: ANN401
    return convert(table[key]) if key in table else default


def _sources(given: object, folder: Path) -> tuple[str, ...]:
    if not isinstance(given, list) or not given:
        raise ValueError(f"sources is {given!r}, not a list of folders or archives")
    return tuple(str(one) if "://" in str(one) else str(folder / str(one)) for one in given)


def _size(given: Sequence[Any]) -> tuple[int, int]:
    width, height = (int(number) for number in given)
    return width, height


def _one_of(*choices: str) -> Callable[[Any], str]:
    def convert(given: object) -> str:
        if given not in choices:
            raise ValueError(f"{given!r} is none of {', '.join(choices)}")
        return str(given)

    return convert
