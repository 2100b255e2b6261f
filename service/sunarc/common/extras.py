"""Dependencies that not every installation has: the extras of the package."""

from __future__ import annotations

import re
from importlib import import_module
from importlib.metadata import PackageNotFoundError, distribution, requires
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from sunarc.common.errors import InputError

_PACKAGED = Path("/usr/lib/sunarc")
"""Where the Debian package has this file; nothing can be installed into it."""


PACKED = ("formats", "hub", "imager", "mqtt", "netcdf", "night", "postgresql")
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
            field=f"extra {extra}", problem=f"{error.name or name} is not installed", remedy=_describe_remedy(extra)
        ) from None


def require_extra(extra: str, *, what: str) -> None:
    """Raise InputError where an extra that a function needs is not installed.

    Parameters
    ----------
    extra : one of the package's; any other needs nothing.
    what : needs it, for the message: a command or an option.

    Raises
    ------
    InputError
        Names a package that is missing, and the line that installs all.
    """
    if missing := missing_packages(extra):
        problem = f"needs sunarc[{extra}], of which {missing[0]} is not installed"
        raise InputError(field=what, problem=problem, remedy=_describe_remedy(extra))


def missing_packages(extra: str) -> list[str]:
    """Return the packages of an extra that are not installed."""
    stated = (requirement.split(";") for requirement in requires("sunarc") or () if ";" in requirement)
    names = [_NAME.match(package) for package, condition in stated if condition.strip() == f"extra == '{extra}'"]
    return [name[0] for name in names if name is not None and not _is_package_installed(name[0])]


_NAME = re.compile(r"[\w.-]+")


def _is_package_installed(package: str) -> bool:
    try:
        distribution(package)
    except PackageNotFoundError:
        return False
    return True


def _describe_remedy(extra: str) -> str:
    if not Path(__file__).is_relative_to(_PACKAGED):
        return f"pip install 'sunarc[{extra}]'"
    if extra in PACKED:
        return "the Debian package has it and was damaged: install the package again (deploy/install)"
    return "the Debian package is without it: run this command from a checkout of sunarc, which has it (deploy/setup)"


def is_installed(name: str) -> bool:
    """Return whether a module of an extra is there; it is not imported for that."""
    return find_spec(name) is not None
