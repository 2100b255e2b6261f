from __future__ import annotations

from tests.fixtures.board import board, clock

__all__ = ["board", "clock"]
