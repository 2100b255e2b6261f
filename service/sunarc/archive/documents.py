"""Calibration documents as parsed, kept by id: what one says of the model never changes."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

from sqlalchemy import Connection, select

from sunarc.archive.tables import calibration

_MOST_KEPT = 128


class Documents:
    """The documents that were asked for lately; parsing one takes longer than finding its row."""

    def __init__(self) -> None:
        self._turn = threading.Lock()
        self._kept: OrderedDict[str, Mapping[str, Any]] = OrderedDict()

    def get(self, connection: Connection, calibration_id: str) -> Mapping[str, Any]:
        """Return the document of a calibration that exists."""
        with self._turn:
            kept = self._kept.get(calibration_id)
            if kept is None:
                of_this = select(calibration.c.document).where(calibration.c.id == calibration_id)
                kept = self._kept[calibration_id] = connection.scalars(of_this).one()
            self._kept.move_to_end(calibration_id)
            if len(self._kept) > _MOST_KEPT:
                self._kept.popitem(last=False)
            return kept
