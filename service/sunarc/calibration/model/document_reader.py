"""Values of a calibration document by dotted keys."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.model.metrics import Metrics
from sunarc.errors import InputError
from sunarc.sky.site import Site


class DocumentReader:
    """Reads values by dotted keys, and names the key where one is wrong."""

    def __init__(self, document: object) -> None:
        self._document = document

    def value(self, key: str, *, needed: bool = True) -> Any:  # noqa: ANN401 - JSON holds anything
        """Return what stands at a key; None where it is missing and not needed."""
        found: Any = self._document
        for part in key.split("."):
            if not isinstance(found, Mapping) or part not in found:
                if not needed:
                    return None
                raise InputError(field=key, problem="missing", remedy="give a whole calibration document")
            found = found[part]
        return found

    def items(self, key: str) -> list[Any]:
        """Return a list."""
        found = self.value(key)
        if not isinstance(found, list | tuple):
            raise InputError(field=key, problem="not a list", remedy="give a list")
        return list(found)

    def number(self, key: str, *, needed: bool = True) -> float:
        """Return a number; null is NaN."""
        found = self.value(key, needed=needed)
        if found is None:
            return math.nan
        if isinstance(found, bool) or not isinstance(found, int | float):
            raise InputError(field=key, problem=f"{found!r} is no number", remedy="give a number")
        return float(found)

    def numbers_of(self, key: str, kind: type[Metrics | Site]) -> dict[str, Any]:
        """Return the numbers that a dataclass holds, by name; those with a default only where there is one."""
        optional = {f.name: f.default is not MISSING for f in fields(kind)}
        found = {name: self.number(f"{key}.{name}", needed=not may_miss) for name, may_miss in optional.items()}
        return {name: number for name, number in found.items() if math.isfinite(number) or not optional[name]}

    def count(self, key: str) -> int:
        """Return a whole number; 0 where there is none."""
        found = self.number(key, needed=False)
        return int(found) if math.isfinite(found) else 0

    def numbers(self, key: str, count: int) -> tuple[float, ...]:
        """Return a number of numbers."""
        return tuple(float(v) for v in self.array(key, (count,)))

    def array(self, key: str, shape: tuple[int, ...]) -> FloatArray:
        """Return finite numbers in a shape.

        Raises
        ------
        InputError
            Naming the key.
        """
        try:
            found = np.array(self.items(key), dtype=np.float64)
        except (TypeError, ValueError) as fault:
            raise InputError(field=key, problem="not an array of numbers", remedy=f"give shape {shape}") from fault
        if found.size == 0 and 0 in shape:
            return np.zeros(shape)
        if found.shape != shape:
            raise InputError(field=key, problem=f"shape {found.shape}", remedy=f"give shape {shape}")
        if not np.all(np.isfinite(found)):
            raise InputError(field=key, problem="a number is not finite", remedy="give finite numbers")
        return found
