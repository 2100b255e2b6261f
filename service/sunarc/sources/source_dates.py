"""Dates in the names of folders and archives: those of one camera that has a folder for each day."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

_YEAR, _TWO = r"(?:19|20)\d\d", r"\d\d"
_DATE = re.compile(
    rf"(?:(?<!\d){_YEAR}(?P<dash>[-_.]?){_TWO}(?P=dash){_TWO}"
    rf"|(?<![A-Za-z\d]){_YEAR}(?:[-_.]?{_TWO})?(?:/{_TWO}){{0,2}})(?!\d)(?=[^/]*/*$)",
    re.ASCII,
)
"""A date in the last name of an address, or in its last folders: 2026, 202601, 2026-01-31, 2026/01/31. A year or month
next to letters may be the number of a camera."""


def by_date(addresses: Sequence[str]) -> list[tuple[str, tuple[str, ...]]]:
    """Return sources by their address without its date, in their order; one that no other is like keeps its own.

    Parameters
    ----------
    addresses : folders and archives, paths or with a scheme.
    """
    alike: dict[str, list[str]] = defaultdict(list)
    for address in addresses:
        alike[_remove_date(address)].append(address)
    found = list[tuple[str, tuple[str, ...]]]()
    for undated, members in alike.items():
        if len(set(members)) > 1:
            found.append((undated.rstrip("/-_."), tuple(dict.fromkeys(members))))
        else:
            found += [(one.rstrip("/"), (one,)) for one in members]
    return found


def _remove_date(address: str) -> str:
    """Return an address without its last date; of a relative path the absolute one, whose folder names the camera."""
    whole = address if "://" in address else str(Path(address).absolute())
    dates = list(_DATE.finditer(whole))
    return whole[: dates[-1].start()] + whole[dates[-1].end() :] if dates else whole
