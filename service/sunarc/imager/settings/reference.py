"""The settings reference: name, default, bounds and meaning of every setting, from the options themselves."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from sunarc.common.bounds import Bound, OneOf, bounds_text, declared_bounds
from sunarc.imager.settings.model import Settings

_HEADING = """\
# Settings

Every setting of the TOML file given with `--config`, with its default and its bounds. In the environment a setting is
`SUNARC_SECTION__NAME=value`. Unknown names and values out of bounds are refused. This page is the output of
`sunarc settings`.
"""
_FOR_PYTHON = (
    "api.burst",
    "api.max_",
    "api.request_within_s",
    "calibration.field_floor_px",
    "calibration.max_",
    "calibration.paper.",
    "calibration.site_error_m",
    "calibration.tolerances.",
    "camera.answer_timeout_s",
    "capture.reopen_",
    "folder.cadence_s",
    "folder.method",
    "folder.poll_s",
    "folder.settle_s",
    "http.timeout_s",
    "rtsp.timeout_s",
    "supervisor.max_restarts",
    "supervisor.within_s",
)
"""Beginning of the names of options' fields that tests and studies vary, and no file sets."""
_ATTRIBUTE = re.compile(r"^    (\w+(?:, \w+)*) : (.*(?:\n        .*)*)", re.MULTILINE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """One setting.

    Attributes
    ----------
    name : dotted path.
    default : as in TOML; "required" without one, "unset" for None.
    allowed : type and bounds in words, or the permitted texts.
    meaning : what it does, with its unit.
    """

    name: str
    default: str
    allowed: str
    meaning: str


def all_settings() -> list[Setting]:
    """Return every setting, those of the top level first."""
    top: list[Setting] = []
    sections: list[Setting] = []
    meanings = documented_attributes(Settings)
    for name, field in Settings.model_fields.items():
        options = dataclass_in(field.annotation)
        if options is None:
            default = "required" if field.is_required() else toml_text(field.default)
            allowed = _describe_allowed(field.annotation)
            top.append(Setting(name=name, default=default, allowed=allowed, meaning=meanings.get(name, "")))
        else:
            sections += list(list_settings(options, name))
    return [setting for setting in top + sections if not setting.name.startswith(_FOR_PYTHON)]


def as_markdown() -> str:
    """Return the settings reference page."""
    parts = [_HEADING]
    for section, settings in groupby(all_settings(), key=lambda one: one.name.rpartition(".")[0]):
        rows = [f"| `{s.name}` | {_format_default(s.default)} | {s.allowed} | {s.meaning} |" for s in settings]
        title = f"[{section}]" if section else "Top level"
        parts.append(
            "\n".join([f"## {title}\n", "| setting | default | allowed | meaning |", "|---|---|---|---|", *rows, ""])
        )
    return "\n".join(parts)


def documented_attributes(documented: type) -> dict[str, str]:
    """Return the meaning of each attribute of a class and its bases from their docstrings' section, on one line."""
    found = [one for each in reversed(documented.__mro__) for one in _ATTRIBUTE.findall(each.__doc__ or "")]
    return {name: " ".join(text.split()) for names, text in found for name in names.split(", ")}


def list_settings(options: type, section: str) -> Iterator[Setting]:
    """Yield the settings of one section, and of the sections within."""
    hints, bounds, meanings = get_type_hints(options), declared_bounds(options), documented_attributes(options)
    for field in fields(options):
        name, inner = f"{section}.{field.name}", dataclass_in(hints[field.name])
        if inner is not None:
            yield from list_settings(inner, name)
            continue
        yield Setting(
            name=name,
            default=_describe_default(field),
            allowed=_describe_allowed(hints[field.name], bounds.get(field.name, ())),
            meaning=meanings.get(field.name, ""),
        )


def _describe_default(field: Field[Any]) -> str:
    if field.default is not MISSING:
        return toml_text(field.default)
    return "required" if field.default_factory is MISSING else toml_text(field.default_factory())


def dataclass_in(annotation: Any) -> Any:  # noqa: ANN401 - any annotation
    """Return the options class of an annotation; None where it is a plain value."""
    return next(
        (one for one in (annotation, *get_args(annotation)) if isinstance(one, type) and is_dataclass(one)), None
    )


def _describe_allowed(annotation: Any, bounds: tuple[Bound, ...] = ()) -> str:  # noqa: ANN401 - any annotation
    if get_origin(annotation) is Literal:
        bounds = (OneOf(get_args(annotation)),)
    if any(isinstance(bound, OneOf) for bound in bounds):
        return bounds_text(bounds)
    return f"{type_name(annotation)} {bounds_text(tuple(dict.fromkeys(bounds))) if bounds else ''}".strip()


def type_name(annotation: Any) -> str:  # noqa: ANN401 - any annotation
    """Return the name of a setting's type as TOML has it."""
    names = {str: "text", bool: "true or false", int: "a whole number", float: "a number", Path: "a path"}
    if annotation in names:
        return names[annotation]
    if get_origin(annotation) is tuple:
        items = [one for one in get_args(annotation) if one is not ...]
        number = "" if ... in get_args(annotation) else f"{len(items)} "
        return f"a list of {number}{type_name(items[0]).removeprefix('a ')}s"
    alternatives = [type_name(one) for one in get_args(annotation) if one is not type(None)]
    return " or ".join(dict.fromkeys(alternatives))


def toml_text(value: object) -> str:
    """Return a value as TOML writes it."""
    if value is None:
        return "unset"
    if isinstance(value, tuple):
        return f"[{', '.join(toml_text(one) for one in value)}]"
    return json.dumps(str(value) if isinstance(value, Path) else value)


def _format_default(default: str) -> str:
    return default if default in {"required", "unset"} else f"`{default}`"
