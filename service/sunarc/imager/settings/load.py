"""Reading of settings: the environment before the file before the defaults; a fault is refused in one line."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from sunarc.common.errors import ConfigurationError, InputError
from sunarc.common.foreign_files import MOST_SETTINGS_BYTES, read_regular
from sunarc.imager.settings.model import HubSettings, Settings
from sunarc.imager.settings.reference import all_settings

Loaded = TypeVar("Loaded", HubSettings, Settings)

_PREFIX = "SUNARC_"
_CONFIG_VARIABLE = "SUNARC_CONFIG"
_KNOWN = {setting.name: setting for setting in all_settings()}
_SECTIONS = {name.partition(".")[0] for name in _KNOWN if "." in name}
_SECTION_OF_SOURCE = {"aravis": "camera", "folder": "folder", "http": "http", "replay": "replay", "rtsp": "rtsp"}


def load_settings(path: Path | None) -> Settings:
    """Return the settings of a TOML file and of the environment, which goes before the file.

    Parameters
    ----------
    path : of the file, UTF-8 with or without a byte order mark; None reads the environment alone.

    Raises
    ------
    ConfigurationError : naming the file, the setting by its dotted path, what was given and what is allowed.
    """
    return _load_file(path, Settings)


def load_hub_settings(path: Path | None) -> HubSettings:
    """Return the settings of a hub, as `load_settings` does; those that concern an imager alone are left out."""
    return _load_file(path, HubSettings)


def parse_settings(text: str, *, where: str) -> Settings:
    """Return the settings of a TOML text and of the environment, as `load_settings` does; `where` names it."""
    try:
        return _load_tables(tomllib.loads(text), Settings, where)
    except (ValueError, RecursionError) as error:  # a number of 5000 digits is no TOMLDecodeError
        raise ConfigurationError(f"{where}: is not TOML: {error}") from None


def _load_file(path: Path | None, model: type[Loaded]) -> Loaded:
    where = str(path) if path else "settings"
    return _load_tables({} if path is None else _read_toml(path), model, where)


def _load_tables(tables: Mapping[str, Any], model: type[Loaded], where: str) -> Loaded:
    given = _merge_tables(tables, _read_environment())
    try:
        _refuse_names(given)
        given = _without_unused_sources(given)
        # JSON mode takes lists for tuples and texts for paths, and strict mode no number in quotes and no true for 1.
        return model.model_validate_json(json.dumps(given, default=str), strict=True)
    except ValidationError as error:
        raise ConfigurationError(f"{where}: {_describe_first_problem(error)}") from None
    except InputError as error:
        raise ConfigurationError(f"{where}: {error}") from None


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(read_regular(path, most_bytes=MOST_SETTINGS_BYTES).decode("utf-8-sig"))
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror}; name a settings file with --config") from None
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{path}: is not UTF-8 ({error.reason}); save it as UTF-8") from None
    except (ValueError, RecursionError) as error:  # a number of 5000 digits is no TOMLDecodeError
        raise ConfigurationError(f"{path}: is not TOML: {error}") from None


def _read_environment() -> dict[str, Any]:
    """Return the settings of SUNARC_SECTION__NAME=value, where value is written as in TOML (or is a bare text)."""
    nested: dict[str, Any] = {}
    for variable, text in sorted(os.environ.items()):
        if not variable.startswith(_PREFIX) or variable == _CONFIG_VARIABLE:
            continue
        *sections, name = variable.removeprefix(_PREFIX).lower().split("__")
        table = nested
        for section in sections:
            table = table.setdefault(section, {})
        table[name] = _parse_toml_value(text)
    return nested


def _parse_toml_value(text: str) -> Any:  # noqa: ANN401 - whatever TOML holds
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text


def _merge_tables(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Return two nested tables as one; where both have a value, that of `above`."""
    both = {
        name: _merge_tables(below[name], above[name])
        for name in below.keys() & above.keys()
        if isinstance(below[name], dict) and isinstance(above[name], dict)
    }
    return {**below, **above, **both}


def _refuse_names(given: Mapping[str, Any]) -> None:
    """Raise where a name is no setting."""
    for name, value in _list_values(given):
        if value == {} and name in _SECTIONS:
            continue
        if name in _SECTIONS:
            raise InputError(
                field=name, problem=f"{value!r} is not a section", remedy=f"write [{name}] and its settings"
            )
        if name not in _KNOWN:
            near = get_close_matches(name, _KNOWN, n=1)
            remedy = f"did you mean {near[0]}?" if near else "remove it or correct its spelling"
            raise InputError(field=name, problem="unknown setting", remedy=remedy)


def _without_unused_sources(given: dict[str, Any]) -> dict[str, Any]:
    """Return the tables without an empty section of another source, as where all of [camera] is commented out."""
    used = _SECTION_OF_SOURCE.get(str(given.get("source", "aravis")))
    return {
        name: value
        for name, value in given.items()
        if value != {} or name == used or name not in _SECTION_OF_SOURCE.values()
    }


def _list_values(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted path and the value of everything in nested tables."""
    for name, value in table.items():
        if isinstance(value, dict) and value:
            yield from _list_values(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _describe_first_problem(error: ValidationError) -> str:
    problem = error.errors()[0]
    name = ".".join(part for part in problem["loc"] if isinstance(part, str))
    others = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    if problem["type"] == "missing":
        return f"setting {name} is missing; add it, or run sunarc init{others}"
    return f"{name}: {problem['input']!r} is not allowed; give {_KNOWN[name].allowed}{others}"
