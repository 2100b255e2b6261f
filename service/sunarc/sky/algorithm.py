"""pvlib's solar position algorithm without the rest of pvlib, whose import takes as long as all else at a start."""

from __future__ import annotations

from functools import cache
from importlib.machinery import PathFinder
from importlib.util import find_spec, module_from_spec
from types import ModuleType


@cache
def load_spa() -> ModuleType:
    """Return `pvlib.spa`, loaded by itself: it needs numpy alone, its package imports pandas and most of scipy.

    Raises
    ------
    ModuleNotFoundError : pvlib is not installed.
    """
    package = find_spec("pvlib")
    spec = None if package is None else PathFinder.find_spec("spa", package.submodule_search_locations)
    if spec is None or spec.loader is None:
        raise ModuleNotFoundError("No module named 'pvlib.spa'", name="pvlib.spa")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
