"""JSON as it is stored."""

from __future__ import annotations

import json
from typing import Any


def json_text(value: object) -> str:
    """Return a value as the text that is stored of it."""
    return json.dumps(value)


def parsed_json(text: str | bytes) -> Any:  # noqa: ANN401 - whatever JSON holds
    """Return a stored value; None where it is no JSON any more."""
    try:
        return json.loads(text)
    except ValueError:
        return None
