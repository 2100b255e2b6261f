"""Every route of the service has a method of the client, in both its kinds."""

from __future__ import annotations

import asyncio
import inspect
import json
from collections.abc import Callable
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.fixtures.archive import make_empty
from tests.fixtures.calibration import current_document, distinctive_calibration

from sunarc.client import AsyncImager, Hub, Imager, ImagerError, LocalImager
from sunarc.client.transport import Transport
from sunarc.hub.archive import open_hub_archive
from sunarc.hub.serving import create_hub_app
from sunarc.imager.runtime.status import StatusSnapshot
from sunarc.imager.web.options import ApiOptions

ROOT = Path(__file__).parents[2]
AT = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
DAY = date(2013, 5, 13)
PIXELS = [[900.0, 800.0]]
ASKED: dict[str, Callable[[Imager], Any]] = {
    "GET /healthz": Imager.alive,
    "GET /readyz": Imager.ready,
    "GET /metrics": Imager.metrics,
    "GET /v1/status": Imager.status,
    "GET /v1/cameras": Imager.cameras,
    "POST /v1/back-project": lambda imager: imager.back_project(PIXELS),
    "POST /v1/project": lambda imager: imager.project([[0.0, 0.0, 1.0]]),
    "POST /v1/geolocate": lambda imager: imager.geolocate(PIXELS, height_m=1000.0),
    "GET /v1/back-projection-map": Imager.map,
    "GET /v1/calibration": Imager.calibration,
    "GET /v1/calibrations": lambda imager: list(imager.calibrations(state="current")),
    "GET /v1/calibrations/{calibration_id}": lambda imager: imager.calibration("a b"),
    "POST /v1/calibrations/{calibration_id}/activate": lambda imager: imager.activate("a", reason="r"),
    "POST /v1/calibrations/{calibration_id}/pin": lambda imager: imager.pin("a", reason="r"),
    "POST /v1/calibrations/{calibration_id}/unpin": lambda imager: imager.unpin("a", reason="r"),
    "GET /v1/days": lambda imager: list(imager.days(since=DAY)),
    "GET /v1/nights": lambda imager: list(imager.nights(images=True)),
    "GET /v1/nights/{night}/image": lambda imager: imager.night_image(DAY),
    "GET /v1/nights/{night}/bodies": lambda imager: imager.night_bodies(DAY),
    "GET /v1/days/{date}/air": lambda imager: imager.day_air(DAY),
    "PUT /v1/days/{date}/air": lambda imager: imager.set_day_air(DAY, pressure_hpa=970.0),
    "POST /v1/epochs/{epoch_id}/close": lambda imager: imager.close_epoch("roof-1", reason="r"),
    "GET /v1/events": lambda imager: list(imager.past_events(severity="alarm")),
    "POST /v1/events/{event_id}/acknowledge": lambda imager: imager.acknowledge(17),
    "GET /v1/events/{event_id}/pictures/{side}": lambda imager: imager.move_picture(17, "after", horizon=True),
    "GET /v1/events/stream": lambda imager: next(imager.events()),
    "GET /v1/housekeeping": lambda imager: imager.housekeeping(step="day", since=AT),
    "GET /v1/image/latest": lambda imager: imager.latest_image(width=64),
    "GET /v1/images": lambda imager: list(imager.images(since=AT)),
    "GET /v1/images/{time}": lambda imager: imager.image(AT, form="jpeg", width=64),
    "GET /v1/images/{time}/rectified": lambda imager: imager.rectified(AT, grid="ground", height_m=900.0),
    "GET /v1/masks/horizon": Imager.horizon_mask,
    "GET /v1/masks/obstructions": Imager.obstruction_mask,
    "GET /v1/horizon": Imager.horizon,
    "GET /v1/masks/sun": Imager.sun_mask,
    "GET /v1/overlay": Imager.overlay,
    "GET /v1/refits": lambda imager: list(imager.refits()),
    "POST /v1/refits": Imager.request_refit,
    "GET /v1/refits/{refit_id}": lambda imager: imager.refit("r1"),
    "GET /v1/remap": lambda imager: imager.remap(size=32),
    "GET /v1/sun": Imager.sun,
    "GET /v1/sun-points": lambda imager: list(imager.sun_points(accepted=True, residuals=True)),
    "GET /v1/sun/track": lambda imager: imager.sun_track(day=DAY, step_s=600),
    "GET /v1/sun-points/days": lambda imager: imager.sightings_by_day(since=DAY),
    "GET /v1/difference": lambda imager: imager.difference("first", cells=8),
    "GET /v1/uncertainty": lambda imager: imager.uncertainty(cells=8),
}

ASKED_OF_A_HUB: dict[str, Callable[[Hub], Any]] = {
    "GET /v1/cross-checks": lambda hub: hub.cross_checks("a b"),
    "GET /v1/fleet": Hub.fleet,
    "GET /v1/nightly": lambda hub: hub.nights(limit=3),
    "GET /v1/quarantine": lambda hub: hub.quarantine("roof", limit=3),
    "GET /v1/summaries": lambda hub: hub.summaries("roof", since=DAY, until=DAY, limit=3),
    "POST /v1/pairs/{a}/{b}/height": lambda hub: hub.pair_height(
        "a", "b/c", at=AT, first_pixel=(1.0, 2.0), second_pixel=(3.0, 4.0)
    ),
}


class AskedError(Exception):
    """Carries what was asked out of the transport."""


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Imager:
    def answer(_self: Transport, request: Any) -> Any:  # noqa: ANN401 - of urllib
        raise AskedError(request.get_method(), request.full_url.removeprefix("http://imager"))

    def lines(_self: Transport, path: str, **_: object) -> Any:  # noqa: ANN401
        raise AskedError("GET", path)

    monkeypatch.setattr(Transport, "_send_request", answer)
    monkeypatch.setattr(Transport, "lines", lines)
    return Imager("http://imager", calibration="best")


def parameters(document: dict[str, Any], route: str) -> set[str]:
    method, path = route.split()
    operation = document["paths"][path][method.lower()]
    return {one["name"] for one in operation.get("parameters", []) if one["in"] == "query"}


def test_every_route_is_asked_by_its_path_with_parameters_that_it_has(asked: Imager) -> None:
    document = json.loads((ROOT / "docs" / "openapi.json").read_text())
    routes = {f"{method.upper()} {path}" for path, one in document["paths"].items() for method in one}
    assert set(ASKED) == routes
    for route, ask in ASKED.items():
        with pytest.raises(AskedError) as told:
            ask(asked)
        method, url = told.value.args
        path, _, query = url.partition("?")
        names = {part.partition("=")[0] for part in query.split("&") if part}
        assert method == route.split()[0]
        assert len(path.split("/")) == len(route.split("/"))
        assert names <= parameters(document, route), route
        assert ("calibration=best" in query) == ("calibration" in parameters(document, route)), route


def test_every_route_of_a_hub_is_asked_by_its_path_with_parameters_that_it_has(asked: Imager, tmp_path: Path) -> None:
    del asked  # its transport answers for the hub too
    make_empty(tmp_path / "hub.sqlite")
    with open_hub_archive(tmp_path / "hub.sqlite") as archive:
        document = create_hub_app(
            archive=archive,
            status=lambda: StatusSnapshot(version="1", started_at=AT),
            now=lambda: AT,
            options=ApiOptions(),
        ).openapi()
    routes = {f"{method.upper()} {path}" for path, one in document["paths"].items() for method in one}
    own = {route for route in routes if "/cameras/" not in route and route not in ASKED}
    assert own == set(ASKED_OF_A_HUB)
    for route, ask in ASKED_OF_A_HUB.items():
        with pytest.raises(AskedError) as told:
            ask(Hub("http://imager"))
        method, url = told.value.args
        path, _, query = url.partition("?")
        assert (method, len(path.split("/"))) == (route.split()[0], len(route.split("/")))
        assert {part.partition("=")[0] for part in query.split("&") if part} == parameters(document, route), route
    with pytest.raises(AskedError) as told:
        Hub("http://imager").imager("a b").days().__next__()
    assert told.value.args[1].startswith("/v1/cameras/a%20b/days")


def test_both_kinds_of_imager_have_the_same_methods() -> None:
    public = {name for name, _ in inspect.getmembers(Imager, inspect.isfunction) if not name.startswith("_")}
    assert public == {name for name in vars(AsyncImager) if not name.startswith("_")}
    assert all(getattr(AsyncImager, name).__doc__ == getattr(Imager, name).__doc__ for name in public)


def test_a_change_is_asked_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []

    def busy(_self: Transport, request: object) -> Any:  # noqa: ANN401
        asked.append(request)
        raise ImagerError("busy", status=503)

    monkeypatch.setattr(Transport, "_send_request", busy)
    with pytest.raises(ImagerError):
        Imager("http://imager").activate("a", reason="r")
    assert len(asked) == 1
    assert not Imager("http://imager").ready()
    assert len(asked) == 2


class Served:
    """An imager whose calibration is what is set here; None: it does not answer."""

    def __init__(self, document: dict[str, Any] | None) -> None:
        self.document = document
        self.tags: list[str | None] = []

    def renewed(self, tag: str | None) -> tuple[dict[str, Any], str] | None:
        self.tags.append(tag)
        if self.document is None:
            raise ImagerError("away", status=None)
        return None if tag == self.document["id"] else (self.document, self.document["id"])


def test_a_local_imager_asks_once_renews_by_its_tag_and_works_without_the_service() -> None:
    first = current_document(distinctive_calibration(higher=0.03))
    served: Any = Served(None)
    local = LocalImager(served, renew_s=3600.0)
    with pytest.raises(ImagerError):
        local.back_project(PIXELS)
    served.document = first
    assert local.back_project(PIXELS).calibration == first["id"]
    assert local.project([[0.0, 0.0, 1.0]]).inside.all()
    assert served.tags == [None, None]
    eager = LocalImager(served, renew_s=0.0)
    for document, expected in ((first, first["id"]), (first | {"id": "next"}, "next"), (None, "next")):
        served.document = document
        assert eager.project([[0.0, 0.0, 1.0]]).calibration == expected
    assert served.tags[2:] == [None, first["id"], "next"]
    alone = LocalImager(document=first)
    assert np.isfinite(alone.back_project(PIXELS).sigma_deg).all()


def test_async_questions_run_beside_one_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Imager, "status", lambda _: {"health": "ready"})
    imager = AsyncImager(Imager("http://imager"))

    async def asking() -> list[Any]:
        pages = [row async for row in imager.days()]
        return [*pages, *await asyncio.gather(imager.alive(), imager.ready())]

    monkeypatch.setattr(Transport, "_send_request", lambda *_: (b'{"days": [{"n": 1}, {"n": 2}], "next": null}', {}))
    assert asyncio.run(asking()) == [{"n": 1}, {"n": 2}, True, True]
