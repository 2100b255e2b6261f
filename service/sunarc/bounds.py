"""Bounds of options, declared beside their types: `cadence_s: Annotated[float, Gt(0.0), Le(3600.0)]`.

The declaration is the only place: `require_bounds` checks it when options are made, `bounds_text` prints it in messages
and in the settings reference, and pydantic reads the same marks when settings are loaded.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any, get_type_hints

from annotated_types import Ge, Gt, Le, Lt

from sunarc.errors import InputError

Bound = Gt | Ge | Lt | Le


def require_bounds(options: object, *, section: str) -> None:
    """Raise where a field of a dataclass is not finite or beyond its declared bounds.

    Parameters
    ----------
    options : an instance of a dataclass whose fields may be annotated with bounds; None and texts have none.
    section : dotted path of the options in the settings; prefixes the field's name in the error.

    Raises
    ------
    InputError
        Naming `section.field`, the value given and what is allowed.
    """
    for name, bounds in bounds_of(type(options)).items():
        for value in _numbers(getattr(options, name)):
            if not math.isfinite(value) or not all(_holds(bound, value) for bound in bounds):
                raise InputError(
                    field=f"{section}.{name}",
                    problem=f"{value:g} is out of bounds",
                    remedy=f"give {bounds_text(bounds)}",
                )


def bounds_of(options: type) -> dict[str, tuple[Bound, ...]]:
    """Return the declared bounds of a dataclass by field; fields without any are absent."""
    return dict(_declared(options))


def bounds_text(bounds: tuple[Bound, ...]) -> str:
    """Return bounds in words, as "above 0 and at most 3600"."""
    words = {Gt: "above {gt:g}", Ge: "at least {ge:g}", Lt: "below {lt:g}", Le: "at most {le:g}"}
    texts = [
        text.format(**limits_of(bound)) for bound in bounds for kind, text in words.items() if isinstance(bound, kind)
    ]
    return " and ".join(texts) or "a finite number"


def limits_of(bound: Bound) -> dict[str, Any]:
    """Return the numbers of a bound by name."""
    return {name: getattr(bound, name) for name in ("gt", "ge", "lt", "le") if hasattr(bound, name)}


@cache
def _declared(options: type) -> dict[str, tuple[Bound, ...]]:
    if not is_dataclass(options):
        raise TypeError(f"{options.__name__} is no dataclass")
    hints = get_type_hints(options, include_extras=True)
    found = {field.name: tuple(_bounds_in(hints[field.name])) for field in fields(options)}
    return {name: bounds for name, bounds in found.items() if bounds}


def _bounds_in(hint: Any) -> Iterator[Bound]:  # noqa: ANN401 - any annotation
    """Yield the bounds anywhere in an annotation: of the value, of an alternative to None, of a tuple's items."""
    yield from (mark for mark in getattr(hint, "__metadata__", ()) if isinstance(mark, Gt | Ge | Lt | Le))
    inner = (hint.__origin__,) if hasattr(hint, "__metadata__") else getattr(hint, "__args__", ())
    for one in inner:
        yield from _bounds_in(one)


def _numbers(value: object) -> Iterator[float]:
    if isinstance(value, bool):
        return
    if isinstance(value, int | float):
        yield float(value)
    elif isinstance(value, tuple):
        for item in value:
            yield from _numbers(item)


def _holds(bound: Bound, value: float) -> bool:
    match bound:
        case Gt():
            return bool(value > bound.gt)  # type: ignore[operator]
        case Ge():
            return bool(value >= bound.ge)  # type: ignore[operator]
        case Lt():
            return bool(value < bound.lt)  # type: ignore[operator]
        case Le():
            return bool(value <= bound.le)  # type: ignore[operator]
