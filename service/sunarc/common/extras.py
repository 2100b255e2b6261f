"""Dependencies that not every installation has: the extras of the package."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from sunarc.common.errors import InputError

_PACKAGED = Path("/usr/lib/sunarc")
"""Where the Debian package has this file; nothing can be installed beside it."""


PACKED = ("formats", "mqtt", "netcdf", "night", "postgresql")
"""Extras that the Debian package brings (deploy/build-deb)."""


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
            field=f"extra {extra}", problem=f"{error.name or name} is not installed", remedy=_remedy(extra)
        ) from None


def _remedy(extra: str) -> str:
    if not Path(__file__).is_relative_to(_PACKAGED):
        return f"install sunarc[{extra}]"
    if extra in PACKED:
        return "the Debian package has it and was damaged: install the package again (deploy/install)"
    return "the Debian package is without it: run this command from a checkout of sunarc, which has it (deploy/setup)"


def is_installed(name: str) -> bool:
    """Return whether a module of an extra is there; it is not imported for that."""
    return find_spec(name) is not None
