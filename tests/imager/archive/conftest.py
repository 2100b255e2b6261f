"""An archive of each engine."""

from __future__ import annotations

from tests.fixtures.stores import archive, engine, hub, path, postgresql, pytest_generate_tests, store

__all__ = ["archive", "engine", "hub", "path", "postgresql", "pytest_generate_tests", "store"]
