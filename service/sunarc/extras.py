"""Dependencies that not every installation has: the extras of the package."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from sunarc.errors import InputError


def extra_module(name: str, *, extra: str) -> Any:  # noqa: ANN401 - a module
    """Return an imported module of an extra.

    Raises
    ------
    InputError
        Where it is not installed, naming the extra that has it.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise InputError(
            field=f"extra {extra}", problem=f"{error.name or name} is not installed", remedy=f"install sunarc[{extra}]"
        ) from None


def is_installed(name: str) -> bool:
    """Return whether a module of an extra is there; it is not imported for that."""
    return find_spec(name) is not None
