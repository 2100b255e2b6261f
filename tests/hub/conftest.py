"""A served archive, as an imager's routes have it."""

from __future__ import annotations

from tests.fixtures.served import archives, empty, made, make

__all__ = ["archives", "empty", "made", "make"]
