"""UTC times: as RFC 3339, as seconds and as whole microseconds since 1970-01-01."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from sunarc.common.errors import InputError

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
MICROSECOND = timedelta(microseconds=1)
DAY_S = 86_400.0


def rfc3339(time: datetime, *, timespec: str = "auto") -> str:
    """Return an aware time in UTC, ending with Z; `timespec` as in `datetime.isoformat`."""
    return time.astimezone(UTC).isoformat(timespec=timespec).replace("+00:00", "Z")


def parse_time(text: str, *, where: str) -> datetime:
    """Return an aware UTC time from ISO 8601 that states its zone; `InputError` names `where`."""
    try:
        time = datetime.fromisoformat(text.strip())
    except ValueError:
        raise InputError(
            field=where, problem=f"{text!r} is not a time", remedy="write ISO 8601, as 2013-05-13T18:30:00Z"
        ) from None
    if time.tzinfo is None:
        raise InputError(field=where, problem=f"{text!r} has no time zone", remedy="end it with Z for UTC")
    try:
        return time.astimezone(UTC)
    except OverflowError:
        raise InputError(
            field=where, problem=f"{text!r} is not within the years 1 to 9999 of UTC", remedy="correct it"
        ) from None


def utc_time(unix_s: float) -> datetime:
    """Return the UTC time of seconds since 1970-01-01, to the nearest microsecond."""
    return datetime.fromtimestamp(unix_s, UTC)


def to_microseconds(time: datetime) -> int:
    """Return the whole microseconds since 1970-01-01 UTC of an aware time."""
    return (time - EPOCH) // MICROSECOND


def from_microseconds(microseconds: int) -> datetime:
    """Return the UTC time of whole microseconds since 1970-01-01; `OverflowError` beyond the years 1 to 9999."""
    return EPOCH + microseconds * MICROSECOND
