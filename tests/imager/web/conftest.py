"""A served archive, as the hub's tests have it as well."""

from __future__ import annotations

from tests.fixtures.served import archives, empty, made, make, write_openapi

__all__ = ["archives", "empty", "made", "make", "write_openapi"]
