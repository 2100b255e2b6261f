"""Server-sent events of a service, as values."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple


class ImagerEvent(NamedTuple):
    """Something that happened.

    kind : "state" (the first one: how things are), "calibration", "bump", "day", "event", "condition_set",
        "condition_cleared", "worker" or "frame".
    data : its numbers and names, see docs/rest.md.
    id : what `Imager.events(after=…)` goes on from.
    """

    kind: str
    data: dict[str, Any]
    id: str


def parsed(lines: Iterable[str]) -> Iterator[ImagerEvent]:
    """Yield the events of a stream's lines; comments and fields of no use here are passed over.

    Raises
    ------
    ValueError, TypeError
        The data are no JSON object.
    """
    fields = {"event": "", "data": "", "id": ""}
    for line in lines:
        name, _, value = line.partition(":")
        if name in fields:
            fields[name] = value.removeprefix(" ")
        if line or not fields["data"]:
            continue
        data = json.loads(fields["data"])
        if not isinstance(data, dict):
            raise TypeError("data that are no object")
        yield ImagerEvent(fields["event"], data, fields["id"])
        fields |= {"event": "", "data": ""}
