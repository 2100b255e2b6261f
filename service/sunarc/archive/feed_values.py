"""Values of a fleet: batches of rows, refusals, and cameras as the hub sees them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from sunarc.errors import InputError
from sunarc.json_fields import EXAMPLE_TIME, Returned, Time, described

Reason = Literal[
    "unknown_camera",
    "forged_token",
    "second_installation",
    "newer_imager",
    "gap",
    "body_too_large",
    "malformed",
    "other_camera",
    "future_clock",
    "newer_document",
    "damaged_document",
    "contradiction",
    "refused_by_database",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class FeedRow:
    """A row as it is sent.

    Attributes
    ----------
    seq : its number in the outbox.
    kind : the table, with ".removed" where the row is there no more; or "status".
    data : the columns; None where they were too large to be sent.
    """

    seq: int
    kind: str
    data: Mapping[str, Any] | None


def feed_lines(rows: Sequence[FeedRow]) -> bytes:
    """Return rows as newline-delimited JSON."""
    lines = (json.dumps({"seq": row.seq, "kind": row.kind, "data": row.data}, allow_nan=False) for row in rows)
    return "".join(f"{line}\n" for line in lines).encode()


def read_feed_lines(body: bytes, *, after: int) -> tuple[FeedRow, ...]:
    """Return the rows of newline-delimited JSON.

    Raises
    ------
    InputError : a line is no row, or the numbers do not rise from `after` on; it names the line.
    """
    rows: list[FeedRow] = []
    for number, line in enumerate(body.splitlines(), 1):
        row = _row(line)
        if row is None or row.seq <= max(after, rows[-1].seq if rows else after):
            problem = "is no row" if row is None else f"has number {row.seq}, which is not after the one before"
            raise InputError(field=f"body, line {number}", problem=problem, remedy='send {"seq", "kind", "data"}')
        rows.append(row)
    return tuple(rows)


def _row(line: bytes) -> FeedRow | None:
    try:
        found = json.loads(line, parse_constant=lambda _: None)  # NaN and infinities: no JSON, and no value
        seq, kind, data = found["seq"], found["kind"], found["data"]
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    formed = type(seq) is int and 0 < seq < 2**63 and isinstance(kind, str) and isinstance(data, dict | None)
    return FeedRow(seq=seq, kind=kind, data=data) if formed else None


@dataclass(frozen=True, slots=True, kw_only=True)
class FeedBatch:
    """Rows of one camera's imager, in their order.

    Attributes
    ----------
    camera, installation : whose.
    after : the imager has nothing between this number and the first row's.
    rows : their numbers rise.
    """

    camera: str
    installation: str
    after: int
    rows: tuple[FeedRow, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """Why something was not taken."""

    reason: Reason
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Quarantined(Returned):
    """Something that an imager sent, and the hub refused or set apart."""

    camera: Annotated[str, described("Name it was sent under.", "imager")]
    installation: Annotated[str, described("Id of the imager's database; empty where not known.", "5f1d")]
    reason: Annotated[Reason, described("Why, in a word.")]
    seq: Annotated[int, described("Number of the row; 0 for what was refused as a whole.", 4711)]
    kind: Annotated[str, described("Kind of the row; empty for what was refused as a whole.", "sun_point")]
    text: Annotated[str, described("Why, in a sentence.", "dated 2099-01-01T00:00:00+00:00, later than now")]
    data: Annotated[str, described("The row as it was sent, JSON; empty where there is none.", "{}")]
    n: Annotated[int, described("How often it came, a count.", 1)]
    first_at: Time
    last_at: Time


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetCamera(Returned):
    """A camera as the hub sees it."""

    camera: Annotated[str, described("Its name.", "imager")]
    latitude: Annotated[float | None, described("Degrees, north positive; null until it sent it.", 36.604)] = None
    longitude: Annotated[float | None, described("Degrees, east positive; null until it sent it.", -97.485)] = None
    altitude: Annotated[float | None, described("Metres above sea level; null until it sent it.", 318.0)] = None
    received_at: Annotated[Time | None, described("When it last sent something; null: never.", EXAMPLE_TIME)] = None
    last_sighting_at: Annotated[Time | None, described("Time of its newest sighting.", EXAMPLE_TIME)] = None
    calibration: Annotated[str | None, described("Id of its current calibration.", "20130514T150508Z-52ee44")] = None
    calibrated_at: Annotated[Time | None, described("When that was made.", EXAMPLE_TIME)] = None
    sky_rms_deg: Annotated[float | None, described("Its 1-sigma over the sky (RMS), degrees.", 0.01)] = None
    status: Annotated[Mapping[str, Any] | None, described("What it last reported of itself.", {"health": "ready"})] = (
        field(default_factory=dict)
    )
    status_at: Annotated[Time | None, described("When that came.", EXAMPLE_TIME)] = None
    n_quarantined: Annotated[int, described("How many things of it are in quarantine.", 0)] = 0
