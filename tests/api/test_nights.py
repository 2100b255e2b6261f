from __future__ import annotations

from datetime import timedelta
from typing import TYPE_CHECKING, Any

from sunarc.archive import Event
from sunarc.findings import Finding
from sunarc.workers.messages import MESSAGES

if TYPE_CHECKING:
    from tests.api.conftest import Made

NUMBERS: dict[str, Any] = {
    "n_images": 48, "n_accepted": 46, "n_stored": 1380, "n_stars": 1700, "n_matched": 620, "limiting_magnitude": 5.5,
    "star_fwhm_px": 2.4, "cloud_fraction": 0.1, "transparency": 0.83,
}  # fmt: skip


def test_nights_are_listed_the_newest_first_with_what_is_known(made: Made) -> None:
    findings = [Finding("night_images", {"n": 46, "images": 48, "cloud_fraction": 0.1}).as_json()]
    told: list[tuple[int, dict[str, Any]]] = [
        (2, {"verdict": "unusable", "n_images": 2}),
        (1, {"verdict": "clear", **NUMBERS}),
    ]
    for days, data in told:
        date = f"{(made.noon - timedelta(days=days)).date()}"
        found = Finding("night", {"date": date, "reasons": "as it was", **data})
        event = Event.of(
            found, MESSAGES, time=made.noon - timedelta(days=days), severity="info", camera="roof",
            details={"findings": findings},
        )  # fmt: skip
        made.archive.add_event(event)
    newest, oldest = made.client.get("/v1/nights").json()["nights"]
    assert newest == {
        "night": "2013-05-12",
        "verdict": "clear",
        "findings": findings,
        "decided_at": "2013-05-12T18:30:00Z",
        **NUMBERS,
    }
    assert (oldest["night"], oldest["n_images"], oldest["limiting_magnitude"]) == ("2013-05-11", 2, None)
    first = made.client.get("/v1/nights", params={"limit": 1}).json()
    assert [night["night"] for night in first["nights"]] == ["2013-05-12"]
    assert first["next"] is not None


def test_without_nights_the_list_is_empty(empty: Made) -> None:
    assert empty.client.get("/v1/nights").json() == {"nights": [], "next": None}
