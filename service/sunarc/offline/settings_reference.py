"""The settings reference: name, default, bounds and meaning of every setting, from the options themselves."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from sunarc.bounds import bounds_of, bounds_text
from sunarc.settings import Settings

_HEADING = """\
# Settings

Every setting of the TOML file given with `--config`, with its default and its bounds. In the environment a setting is
`SUNARC_SECTION__NAME=value`. Unknown names and values out of bounds are refused. This page is the output of
`sunarc settings`.
"""
_ATTRIBUTE = re.compile(r"^    (\w+(?:, \w+)*) : (.*(?:\n        .*)*)", re.MULTILINE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """One setting.

    Attributes
    ----------
    name : dotted path.
    default : as in TOML; "required" where there is none, "unset" for None.
    allowed : bounds in words or the permitted texts; the type where it has neither.
    meaning : what it does, with its unit.
    """

    name: str
    default: str
    allowed: str
    meaning: str


def all_settings() -> list[Setting]:
    """Return every setting, those of the top level first."""
    top, sections = [], []
    meanings = attributes_of(Settings)
    for name, field in Settings.model_fields.items():
        options = _dataclass_in(field.annotation)
        if options is None:
            default = "required" if field.is_required() else _toml(field.default)
            allowed = _allowed(field.annotation, "")
            top.append(Setting(name=name, default=default, allowed=allowed, meaning=meanings.get(name, "")))
        else:
            sections += list(_of_options(options, name))
    return top + sections


def as_markdown() -> str:
    """Return the settings reference page."""
    parts = [_HEADING]
    for section, settings in groupby(all_settings(), key=lambda one: one.name.rpartition(".")[0]):
        rows = [f"| `{s.name}` | {_cell(s.default)} | {s.allowed} | {s.meaning} |" for s in settings]
        title = f"[{section}]" if section else "Top level"
        parts.append(
            "\n".join([f"## {title}\n", "| setting | default | allowed | meaning |", "|---|---|---|---|", *rows, ""])
        )
    return "\n".join(parts)


def attributes_of(documented: type) -> dict[str, str]:
    """Return the meaning of each attribute of a class from the numpydoc section of its docstring, on one line."""
    found = _ATTRIBUTE.findall(documented.__doc__ or "")
    return {name: " ".join(text.split()) for names, text in found for name in names.split(", ")}


def _of_options(options: type, section: str) -> Iterator[Setting]:
    hints, bounds, meanings = get_type_hints(options), bounds_of(options), attributes_of(options)
    for field in fields(options):
        name, inner = f"{section}.{field.name}", _dataclass_in(hints[field.name])
        if inner is not None:
            yield from _of_options(inner, name)
            continue
        yield Setting(
            name=name,
            default=_default(field),
            allowed=_allowed(hints[field.name], bounds_text(bounds[field.name]) if field.name in bounds else ""),
            meaning=meanings.get(field.name, ""),
        )


def _default(field: Field[Any]) -> str:
    if field.default is not MISSING:
        return _toml(field.default)
    return "required" if field.default_factory is MISSING else _toml(field.default_factory())


def _dataclass_in(annotation: Any) -> Any:  # noqa: ANN401 - any annotation
    """Return the options class of an annotation; None where it is a plain value."""
    return next(
        (one for one in (annotation, *get_args(annotation)) if isinstance(one, type) and is_dataclass(one)), None
    )


def _allowed(annotation: Any, bounds: str) -> str:  # noqa: ANN401 - any annotation
    choices = [
        choice for one in (annotation, *get_args(annotation)) if get_origin(one) is Literal for choice in get_args(one)
    ]
    if choices:
        return ", ".join(f"`{json.dumps(choice)}`" for choice in choices)
    return bounds or _type_name(annotation)


def _type_name(annotation: Any) -> str:  # noqa: ANN401 - any annotation
    names = {str: "text", bool: "true or false", int: "whole number", float: "number", Path: "path"}
    if annotation in names:
        return names[annotation]
    if get_origin(annotation) is tuple:
        return "list of " + " and ".join(
            dict.fromkeys(_type_name(one) for one in get_args(annotation) if one is not ...)
        )
    alternatives = [_type_name(one) for one in get_args(annotation) if one is not type(None)]
    return " or ".join(dict.fromkeys(alternatives))


def _toml(value: object) -> str:
    if value is None:
        return "unset"
    if isinstance(value, tuple):
        return f"[{', '.join(_toml(one) for one in value)}]"
    return json.dumps(str(value) if isinstance(value, Path) else value)


def _cell(default: str) -> str:
    return default if default in {"required", "unset"} else f"`{default}`"
