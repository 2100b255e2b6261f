"""JSON as files and commands have it."""

from __future__ import annotations

import json


def json_text(value: object) -> str:
    """Return a value as JSON on lines, the last one ended; ValueError where a number is not finite."""
    return json.dumps(value, indent=1, allow_nan=False) + "\n"
