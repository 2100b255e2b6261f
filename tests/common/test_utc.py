"""Times as text, seconds and microseconds."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sunarc.common.errors import InputError
from sunarc.common.utc import EPOCH, from_microseconds, parse_time, rfc3339, to_microseconds, utc_time

_WEST = timezone(timedelta(hours=-8))


@pytest.mark.parametrize(
    ("time", "timespec", "text"),
    [
        (datetime(2013, 5, 13, 18, 30, tzinfo=UTC), "auto", "2013-05-13T18:30:00Z"),
        (datetime(2013, 5, 13, 18, 30, 0, 5, tzinfo=UTC), "auto", "2013-05-13T18:30:00.000005Z"),
        (datetime(2013, 5, 13, 18, 30, tzinfo=UTC), "microseconds", "2013-05-13T18:30:00.000000Z"),
        (datetime(2013, 5, 13, 22, 30, 59, 999_999, tzinfo=_WEST), "seconds", "2013-05-14T06:30:59Z"),
    ],
)
def test_text_is_in_utc_and_ends_with_z(time: datetime, timespec: str, text: str) -> None:
    assert rfc3339(time, timespec=timespec) == text


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])  # the host may be busy
@given(st.datetimes(min_value=datetime(1970, 1, 1), max_value=datetime(2199, 12, 31)))  # noqa: DTZ001 - zoned below
def test_every_time_returns_from_its_text_its_microseconds_and_its_seconds(naive: datetime) -> None:
    time = naive.replace(tzinfo=UTC)
    assert parse_time(rfc3339(time), where="t") == time
    assert from_microseconds(to_microseconds(time)) == time
    # A float64 of seconds since 1970 resolves less than half a microsecond until 2242.
    assert utc_time(time.timestamp()) == time


def test_seconds_are_rounded_to_the_nearest_microsecond() -> None:
    assert utc_time(1.000_000_4) == EPOCH + timedelta(seconds=1)
    assert utc_time(1.000_000_6) == EPOCH + timedelta(seconds=1, microseconds=1)


@pytest.mark.parametrize(
    "text", ["0001-01-01T00:00:00+05:00", "9999-12-31T23:59:59-05:00", "2013-05-13T18:30:00", "noon"]
)
def test_a_text_that_is_no_utc_time_is_refused_by_its_field(text: str) -> None:
    with pytest.raises(InputError) as refused:
        parse_time(text, where="--from")
    assert (refused.value.field, text in refused.value.problem) == ("--from", True)
