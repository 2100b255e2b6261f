from __future__ import annotations

from tests.fixtures.command_line import sunarc

__all__ = ["sunarc"]
