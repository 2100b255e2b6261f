"""Bounds of options, declared with their types: `cadence_s: Annotated[float, Gt(0.0), Le(3600.0)]`.

The declaration is the only place: `require_bounds` checks it when options are made, `bounds_text` prints it in messages
and in the settings reference, and pydantic reads the same marks when settings are loaded. The choices of a `Literal`
are checked in the same way.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Le, Lt

from sunarc.common.errors import InputError


@dataclass(frozen=True, slots=True)
class OneOf:
    """Bound of the values that a `Literal` permits."""

    choices: tuple[object, ...]


Bound = Gt | Ge | Lt | Le | OneOf

Positive = Annotated[float, Gt(0.0)]
NonNegative = Annotated[float, Ge(0.0)]
Share = Annotated[float, Ge(0.0), Le(1.0)]
Count = Annotated[int, Ge(1)]


def require_bounds(options: object, *, section_path: str) -> None:
    """Raise where a field of a dataclass is not finite, beyond its declared bounds, or none of its choices.

    Parameters
    ----------
    options : an instance of a dataclass whose fields may be annotated with bounds or be a `Literal`; None has neither.
    section_path : dotted path of the options in the settings; prefixes the field's name in the error, unless empty.

    Raises
    ------
    InputError
        Naming `section_path.field`, the value given and what is allowed.
    """
    for name, bounds in declared_bounds(type(options)).items():
        for value in _list_values(getattr(options, name)):
            if not all(_is_within(bound, value) for bound in bounds):
                raise InputError(
                    field=f"{section_path}.{name}".lstrip("."),
                    problem=f"{value!r} is not allowed",
                    remedy=f"give {bounds_text(bounds)}",
                )


def declared_bounds(options: type) -> dict[str, tuple[Bound, ...]]:
    """Return the declared bounds of a dataclass by field; fields without any are absent."""
    return dict(_collect_bounds(options))


def bounds_text(bounds: tuple[Bound, ...]) -> str:
    """Return bounds in words, as "above 0 and at most 3600"."""
    return " and ".join(map(_describe_bound, bounds)) or "a finite number"


def _describe_bound(bound: Bound) -> str:
    match bound:
        case Gt():
            return f"above {bound.gt:.12g}"
        case Ge():
            return f"at least {bound.ge:.12g}"
        case Lt():
            return f"below {bound.lt:.12g}"
        case Le():
            return f"at most {bound.le:.12g}"
        case OneOf():
            return "one of " + ", ".join(json.dumps(choice) for choice in bound.choices)


@cache
def _collect_bounds(options: type) -> dict[str, tuple[Bound, ...]]:
    if not is_dataclass(options):
        raise TypeError(f"{options.__name__} is not a dataclass")
    hints = get_type_hints(options, include_extras=True)
    found = {field.name: tuple(_bounds_in(hints[field.name])) for field in fields(options)}
    return {name: bounds for name, bounds in found.items() if bounds}


def _bounds_in(hint: Any) -> Iterator[Bound]:  # noqa: ANN401 - any annotation
    """Yield the bounds anywhere in an annotation: of the value, of an alternative to None, of a tuple's items."""
    if get_origin(hint) is Literal:
        yield OneOf(get_args(hint))
        return
    yield from (mark for mark in getattr(hint, "__metadata__", ()) if isinstance(mark, Gt | Ge | Lt | Le))
    inner = (hint.__origin__,) if hasattr(hint, "__metadata__") else getattr(hint, "__args__", ())
    for one in inner:
        yield from _bounds_in(one)


def _list_values(value: object) -> Iterator[Any]:
    if isinstance(value, tuple):
        for item in value:
            yield from _list_values(item)
    elif value is not None:
        yield value


def _is_within(bound: Bound, value: Any) -> bool:  # noqa: ANN401 - a number, or a choice
    if isinstance(bound, OneOf):
        return value in bound.choices
    if not math.isfinite(value):
        return False
    match bound:
        case Gt():
            return bool(value > bound.gt)
        case Ge():
            return bool(value >= bound.ge)
        case Lt():
            return bool(value < bound.lt)
        case Le():
            return bool(value <= bound.le)
