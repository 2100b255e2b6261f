from __future__ import annotations

from datetime import timedelta
from typing import TYPE_CHECKING, Any

import pytest

from sunarc.imager.archive.values import Event, Refit

if TYPE_CHECKING:
    from tests.fixtures.served import Made


def all_pages(made: Made, link: str, key: str) -> list[list[dict[str, Any]]]:
    pages = []
    while link:
        answer = made.client.get(link)
        assert answer.status_code == 200, answer.text
        pages.append(answer.json()[key])
        link = answer.json()["next"]
        assert len(pages) < 100
    return pages


@pytest.mark.parametrize(
    ("path", "key", "limit"),
    [
        ("/v1/sun-points?accepted=true", "sun_points", 7),
        ("/v1/days", "days", 1),
        ("/v1/calibrations", "calibrations", 1),
        ("/v1/events?since=2013-01-01T00:00:00Z", "events", 1),
    ],
)
def test_the_pages_together_are_the_whole(made: Made, path: str, key: str, limit: int) -> None:
    (whole,) = all_pages(made, path, key)
    pages = all_pages(made, f"{path}{'&' if '?' in path else '?'}limit={limit}", key)
    assert len(whole) > limit
    assert [row for page in pages for row in page] == whole
    assert {len(page) for page in pages[:-1]} == {limit}
    assert 0 < len(pages[-1]) <= limit


@pytest.mark.parametrize("limit", [1, 2, 3, 5, 8])
def test_rows_of_one_moment_are_told_once_each(empty: Made, limit: int) -> None:
    moments = [0, 0, 0, 0, 1, 1, 2]
    for number, seconds in enumerate(moments):
        at = empty.noon + timedelta(seconds=seconds)
        empty.archive.events.add(Event(time=at, kind="test", severity="info", text=str(number), camera="roof"))
        empty.archive.refits.add(Refit(id=f"r{number}", camera="roof", requested_at=at, reason=str(number)))
    told = [row["text"] for page in all_pages(empty, f"/v1/events?limit={limit}", "events") for row in page]
    assert told == ["6", "5", "4", "3", "2", "1", "0"]
    refits = [row["id"] for page in all_pages(empty, f"/v1/refits?limit={limit}", "refits") for row in page]
    assert refits == ["r6", "r5", "r4", "r3", "r2", "r1", "r0"]


def test_what_comes_new_does_not_shift_the_pages(made: Made) -> None:
    first = made.client.get("/v1/events?limit=1").json()
    made.archive.events.add(Event(time=made.noon + timedelta(days=1), kind="late", severity="info", text="new"))
    second = made.client.get(first["next"]).json()
    assert [event["kind"] for event in (*first["events"], *second["events"])] == ["refit_refused", "start"]


def test_a_page_keeps_what_was_asked(made: Made) -> None:
    link = made.client.get("/v1/sun-points?accepted=false&residuals=true&limit=3").json()["next"]
    assert all(not point["accepted"] for page in all_pages(made, link, "sun_points") for point in page)
    assert "residuals=true" in link


@pytest.mark.parametrize("cursor", ["", "x", "1", "-1", "1-", "99999999999999999-0", "1-99999", "1-1 "])
def test_a_cursor_that_is_none_is_refused(made: Made, cursor: str) -> None:
    answer = made.client.get("/v1/events", params={"cursor": cursor})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == "cursor"


@pytest.mark.parametrize("path", ["/v1/events", "/v1/days", "/v1/sun-points", "/v1/calibrations", "/v1/refits"])
@pytest.mark.parametrize("cursor", ["0-0", "9999999999999999-9999"])
def test_the_farthest_cursors_are_answered(made: Made, path: str, cursor: str) -> None:
    assert made.client.get(path, params={"cursor": cursor}).status_code == 200
