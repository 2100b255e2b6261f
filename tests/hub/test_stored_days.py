"""What the hub says that it has of a camera: to that camera's sender alone, by day."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from datetime import date

import httpx
import pytest
from pydantic import TypeAdapter
from tests.fixtures.fleet import NOW
from tests.hub.test_hub import TOKEN, Hub, body_of, hub, imager

from sunarc.hub.archive import HubArchive
from sunarc.hub.feed_routes import token_digest
from sunarc.imager.archive.database.schema import head_revision
from sunarc.imager.archive.day_digests import DayDigests, StoredDays

__all__ = ["hub", "imager"]

OF_MAST = "the token of the mast"
ASKED = {"since": "2026-05-01", "until": "2026-06-02"}


def ask(
    hub: Hub, *, camera: str = "roof", token: str = TOKEN, installation: str = "here", **changed: str
) -> httpx.Response:
    revision = changed.pop("revision", head_revision())
    headers = {"authorization": f"Bearer {token}", "sunarc-installation": installation, "sunarc-revision": revision}
    return hub.client.request("GET", f"/v1/cameras/{camera}/feed", params=ASKED | changed, headers=headers)


def test_a_sender_hears_what_the_hub_has_of_its_camera(hub: Hub, imager: HubArchive) -> None:
    hub.put(body_of(imager))
    answer = ask(hub)
    assert answer.status_code == 200
    read = TypeAdapter(StoredDays).validate_python(answer.json())  # as a sender reads it
    found = hub.archive.feeds.digests("roof", "here", since=date(2026, 5, 1), until=date(2026, 6, 2))
    assert found is not None
    assert (read.revision, read.until, read.days) == (head_revision(), found.until, found.days)
    assert read.days["sun_point"][date(2026, 5, 13)].n == 3  # type: ignore[union-attr]
    assert answer.json()["days"]["pose_epoch"] == {}  # of a day before


def test_nobody_else_hears_it(hub: Hub, imager: HubArchive) -> None:
    hub.put(body_of(imager))
    hub.archive.feeds.add_token("mast", token_digest(OF_MAST), now=NOW, former_until=NOW)
    assert ask(hub, token="").status_code == 401
    assert ask(hub, token=OF_MAST).status_code == 401
    assert ask(hub, camera="gate").status_code == 404
    assert ask(hub, installation="other").status_code == 409
    assert ask(hub, camera="mast", token=OF_MAST).status_code == 409  # it sent nothing
    assert hub.archive.feeds.digests("mast", "here", since=date(2026, 5, 1), until=date(2026, 6, 2)) is None


def test_of_tables_of_another_revision_nothing_is_said(hub: Hub, imager: HubArchive) -> None:
    hub.put(body_of(imager))
    said = ask(hub, revision="0018").json()
    assert said["revision"] == head_revision()
    assert said["until"] == ASKED["since"]
    assert not any(said["days"].values())


@pytest.mark.parametrize("wrong", [{"since": "yesterday"}, {"until": "2026-13-01"}, {"since": ""}, {"until": "9e18"}])
def test_a_day_that_is_none_is_refused(hub: Hub, imager: HubArchive, wrong: dict[str, str]) -> None:
    hub.put(body_of(imager))
    assert ask(hub, **wrong).status_code == 422


@pytest.mark.parametrize("wrong", [{"since": "0001-01-01", "until": "9999-12-31"}, {"since": "9999-12-31"}])
def test_days_that_are_no_window_cost_nothing(hub: Hub, imager: HubArchive, wrong: dict[str, str]) -> None:
    hub.put(body_of(imager))
    answer = ask(hub, **wrong)
    assert answer.status_code == 200
    assert not any(answer.json()["days"].values())


def test_one_comparison_at_a_time_is_made_and_the_others_are_asked_to_wait(
    hub: Hub, imager: HubArchive, monkeypatch: pytest.MonkeyPatch
) -> None:
    hub.put(body_of(imager))
    begun, may_end, digests = threading.Event(), threading.Event(), hub.archive.feeds.digests

    def slow(camera: str, installation: str, *, since: date, until: date) -> DayDigests | None:
        begun.set()
        assert may_end.wait(30.0)
        return digests(camera, installation, since=since, until=until)

    monkeypatch.setattr(hub.archive.feeds, "digests", slow)
    with ThreadPoolExecutor() as pool:
        first = pool.submit(ask, hub)
        assert begun.wait(30.0)
        busy = pool.submit(ask, hub)
        answer = busy.result(30.0)
        assert (answer.status_code, answer.headers["retry-after"]) == (429, "30")
        assert ask(hub, token="").status_code == 401  # a stranger learns nothing of it
        may_end.set()
        assert first.result(30.0).status_code == 200
    assert ask(hub).status_code == 200
