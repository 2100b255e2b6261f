"""The hub over HTTP: feeds, the fleet, quarantine, and every camera's routes."""

from __future__ import annotations

import gzip
import json
import os
import shutil
import signal
import sqlite3
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path
from typing import Any

import httpx
import psycopg
import pytest
from sqlalchemy import URL
from tests.fixtures.archive import make_empty
from tests.fixtures.fleet import NOW, new_imager, next_batch, sighting
from tests.fixtures.postgresql import TEMPLATE, Server, running_server
from tests.fixtures.served import Client
from tests.imager.workers.test_full_disk import mounted

from sunarc.hub.archive import HubArchive, open_hub_archive
from sunarc.hub.feed_routes import MOST_BYTES, MOST_LISTS, token_digest
from sunarc.hub.fleet_states import SILENT
from sunarc.hub.nightly_store import CrossCheck, NightlyRun
from sunarc.hub.serving import create_hub_app
from sunarc.imager.archive.database.schema import head_revision
from sunarc.imager.archive.feed_rows import MOST_ROWS, feed_lines
from sunarc.imager.archive.values import Day
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import Reason, StatusRegistry, StatusSnapshot
from sunarc.imager.web.options import ApiOptions
from sunarc.imager.workers.upkeep import StoreRoomWorker

TOKEN = "the token of the camera roof"  # noqa: S105 - of the test alone
METRICS = {
    f"sunarc_fleet_{name}"
    for name in (
        "received_seconds",
        "status_seconds",
        "last_sighting_seconds",
        "sky_sigma_degrees",
        "quarantined",
        "disk_free_bytes",
        "clock_error_seconds",
        "drift_degrees",
        "state",
        "cross_check",
    )
}


@dataclass
class Hub:
    archive: HubArchive
    client: Client
    now: list[Any]

    def put(
        self,
        body: bytes,
        *,
        camera: str = "roof",
        after: int | str = 0,
        token: str = TOKEN,
        installation: str = "here",
        revision: str | None = None,
    ) -> httpx.Response:
        headers = {
            "authorization": f"Bearer {token}",
            "sunarc-installation": installation,
            "sunarc-revision": revision or head_revision(),
            "content-encoding": "gzip",
        }
        return self.client.request("PUT", f"/v1/cameras/{camera}/feed?after={after}", content=body, headers=headers)

    def reasons(self) -> list[str]:
        return [row["reason"] for row in self.client.get("/v1/quarantine").json()["rows"]]


@pytest.fixture
def hub(tmp_path: Path) -> Iterator[Hub]:
    yield from made(tmp_path)


def made(folder: Path, **options: Any) -> Iterator[Hub]:  # noqa: ANN401 - of ApiOptions
    make_empty(folder / "hub.sqlite")
    now = [NOW]
    with open_hub_archive(folder / "hub.sqlite") as archive:
        archive.feeds.add_token("roof", token_digest(TOKEN), now=NOW, former_until=NOW)
        app = create_hub_app(
            archive=archive,
            status=lambda: StatusSnapshot(version="1", started_at=NOW),
            now=lambda: now[0],
            options=ApiOptions(allowed_hosts=("imager",), **options),
        )
        yield Hub(archive, Client(app), now)


@pytest.fixture
def imager(tmp_path: Path) -> Iterator[HubArchive]:
    with new_imager(tmp_path) as archive:
        archive.sightings.add(sighting(n) for n in range(3))
        yield archive


def body_of(imager: HubArchive) -> bytes:
    return gzip.compress(feed_lines(next_batch(imager).rows))


def test_rows_are_stored_and_answered_for_their_camera(hub: Hub, imager: HubArchive) -> None:
    answer = hub.put(body_of(imager))
    assert (answer.status_code, answer.json()) == (200, {"committed": 5})
    assert hub.put(body_of(imager)).json() == {"committed": 5}
    points = hub.client.get("/v1/cameras/roof/sun-points").json()
    assert len(points["sun_points"]) == 3
    assert hub.client.get("/v1/cameras").json()["cameras"][0]["name"] == "roof"
    for path in ("days", "events", "calibrations", "sun"):
        assert hub.client.get(f"/v1/cameras/roof/{path}").status_code == 200, path
    assert hub.client.get("/v1/cameras/mast/days").status_code == 404


def test_no_rows_after_minus_one_ask_where_the_hub_stands(hub: Hub, imager: HubArchive) -> None:
    """As `sunarc check` asks: nothing is stored, nothing is set apart, and a wrong token is refused."""
    hub.put(body_of(imager))
    nothing = gzip.compress(b"")
    assert hub.put(nothing, after=-1).json() == {"committed": 5}
    assert hub.reasons() == []
    assert hub.put(nothing, after=-1, token="x" * 16).status_code == 401
    assert len(hub.client.get("/v1/cameras/roof/sun-points").json()["sun_points"]) == 3


@pytest.mark.parametrize("path", ["days", "calibration", "sun-points", "events"])
def test_a_hub_has_no_camera_of_its_own(hub: Hub, path: str) -> None:
    answer = hub.client.get(f"/v1/{path}")
    assert answer.status_code == 404
    assert answer.json()["errors"][0]["field"] == "camera"


@pytest.mark.parametrize(
    ("method", "path"),
    [("POST", "refits"), ("PUT", "days/2026-05-13/air"), ("POST", "calibrations/a/activate")],
)
def test_a_hub_changes_nothing_that_an_imager_decides(hub: Hub, imager: HubArchive, method: str, path: str) -> None:
    hub.put(body_of(imager))
    answer = hub.client.request(method, f"/v1/cameras/roof/{path}", json={"reason": "test"})
    assert answer.status_code == 403


@pytest.mark.parametrize(
    ("changes", "status", "reason"),
    [
        ({"camera": "mast"}, 404, "unknown_camera"),
        ({"token": "forged, but long enough"}, 401, "forged_token"),
        ({"token": ""}, 401, "forged_token"),
        ({"installation": "another"}, 409, "second_installation"),
        ({"installation": "no id!"}, 422, "malformed"),
        ({"revision": "9999"}, 409, "newer_imager"),
        ({"body": b"no gzip"}, 422, "malformed"),
        ({"body": gzip.compress(b"{}\n")}, 422, "malformed"),
        ({"body": gzip.compress(b"x" * 1000)[:-9]}, 422, "malformed"),
        ({"body": gzip.compress(b"\n" * (MOST_BYTES + 1))}, 413, "body_too_large"),
        ({"body": b"x" * 8_000_001}, 413, "body_too_large"),
        ({"after": 9}, 200, "gap"),
    ],
)
def test_what_is_refused_is_answered_and_seen_and_nothing_else_stops(
    hub: Hub, imager: HubArchive, changes: dict[str, Any], status: int, reason: str
) -> None:
    assert hub.put(body_of(imager)).status_code == 200
    body = changes.pop("body", gzip.compress(b""))
    for _ in range(2):
        assert hub.put(body, **{"after": 5, **changes}).status_code == status
    assert hub.reasons() == [reason]
    fleet = {one["camera"]: one for one in hub.client.get("/v1/fleet").json()["cameras"]}
    if reason != "unknown_camera":
        assert (fleet["roof"]["n_quarantined"], "quarantine" in str(fleet["roof"]["why"])) == (1, True)
    imager.outbox.acknowledge(5)
    imager.sightings.add([sighting(9)])
    assert hub.put(body_of(imager), after=5).json() == {"committed": 6}


def test_the_token_of_one_camera_is_none_of_anothers(hub: Hub, imager: HubArchive) -> None:
    hub.archive.feeds.add_token("mast", token_digest("the token of the camera mast"), now=NOW, former_until=NOW)
    assert hub.put(body_of(imager), token="the token of the camera mast").status_code == 401  # noqa: S106
    assert hub.put(body_of(imager), camera="mast").status_code == 401
    assert hub.reasons() == ["forged_token", "forged_token"]


def test_a_body_of_two_gigabytes_is_refused_before_it_is_read(hub: Hub) -> None:
    headers = {"content-length": str(2 * 10**9), "authorization": f"Bearer {TOKEN}", "sunarc-installation": "here"}
    path = "/v1/cameras/roof/feed?after=0"
    answer = hub.client.request("PUT", path, content=b"", headers={**headers, "sunarc-revision": head_revision()})
    assert answer.status_code == 413
    assert hub.reasons() == ["body_too_large"]


def test_a_sender_of_whose_rows_none_can_be_stored_waits_ever_longer_and_no_other_does(
    hub: Hub, imager: HubArchive
) -> None:
    hub.archive.feeds.add_token("mast", token_digest("the token of the camera mast"), now=NOW, former_until=NOW)
    assert hub.put(body_of(imager)).status_code == 200
    waits: list[int] = []
    for after in range(5, 16):
        wrong = gzip.compress(b'{"seq": %d, "kind": "sun_point", "data": {"x": 1}}\n' % (after + 1))
        answer = hub.put(wrong, after=after)
        assert answer.json() == {"committed": after + 1}
        waits.append(int(answer.headers.get("retry-after", 0)))
        if waits[-1]:
            refused = hub.put(wrong, after=after + 1)
            assert (refused.status_code, int(refused.headers["retry-after"])) == (429, waits[-1])
            assert hub.put(wrong, after=after + 1, token="a stranger's").status_code == 401  # noqa: S106
            hub.now[0] += timedelta(seconds=waits[-1])
    assert waits == [0, 0, 0, 1, 2, 4, 8, 16, 32, 60, 60]
    assert hub.put(gzip.compress(b""), camera="mast", token="the token of the camera mast").status_code == 200  # noqa: S106
    imager.outbox.acknowledge(5)
    imager.sightings.add([sighting(9)])
    line = feed_lines(next_batch(imager).rows).replace(b'"seq": 6', b'"seq": 17')
    good = hub.put(gzip.compress(line), after=16)
    assert (good.json(), "retry-after" in good.headers) == ({"committed": 17}, False)
    assert "retry-after" not in hub.put(gzip.compress(b'{"seq": 18, "kind": "x", "data": {}}'), after=17).headers


def test_a_small_body_that_holds_much_waits_with_the_large_ones_and_one_that_needs_much_memory_is_refused(
    hub: Hub, imager: HubArchive
) -> None:
    assert hub.put(body_of(imager)).status_code == 200
    text = b"x" * 500_000
    assert (
        hub.put(gzip.compress(b'{"seq": 6, "kind": "event", "data": {"text": "%s"}}' % text), after=5).status_code
        == 200
    )
    lists = b'{"seq": 7, "kind": "status", "data": {"x": [' + b"[]," * MOST_LISTS + b"[]]}}"
    rows = b"".join(b'{"seq": %d, "kind": "x", "data": {}}\n' % n for n in range(7, MOST_ROWS + 9))
    for body in (lists, rows, b"\n" * 1_000_000):
        assert hub.put(gzip.compress(body), after=6).status_code == 413


@pytest.mark.parametrize("after", ["-2", "x", str(2**63), ""])
def test_a_number_that_is_none_is_refused(hub: Hub, after: str) -> None:
    assert hub.put(gzip.compress(b""), after=after).status_code == 422


def test_a_token_that_was_replaced_ends_after_the_overlap(hub: Hub, imager: HubArchive) -> None:
    later = NOW + timedelta(hours=1)
    hub.archive.feeds.add_token("roof", token_digest("a new one, long enough"), now=NOW, former_until=later)
    for token, status in ((TOKEN, 200), ("a new one, long enough", 200)):
        assert hub.put(body_of(imager), token=token).status_code == status
    hub.now[0] = later
    assert hub.put(body_of(imager)).status_code == 401


def test_the_digest_alone_is_stored(hub: Hub, tmp_path: Path) -> None:
    assert hub.archive.feeds.tokens("roof", now=NOW) == (token_digest(TOKEN),)
    hub.archive.close()
    assert TOKEN.encode() not in (tmp_path / "hub.sqlite").read_bytes()


def test_reading_with_a_token_leaves_the_feed_to_its_own(tmp_path: Path, imager: HubArchive) -> None:
    (tmp_path / "read").write_text("a token for reading\n")
    for hub in made(tmp_path, read_token_file=tmp_path / "read"):
        assert hub.client.get("/v1/fleet").status_code == 401
        assert hub.client.get("/v1/fleet", headers={"authorization": f"Bearer {TOKEN}"}).status_code == 401
        assert hub.client.get("/v1/fleet", headers={"authorization": "Bearer a token for reading"}).status_code == 200
        assert hub.put(body_of(imager), token="a token for reading").status_code == 401  # noqa: S106
        assert hub.put(body_of(imager)).status_code == 200


def test_the_fleet_has_the_worst_first(hub: Hub, tmp_path: Path) -> None:
    healths = {"a": "ready", "b": "degraded", "c": "not_ready"}
    for name, health in healths.items():
        hub.archive.feeds.add_token(name, token_digest(TOKEN + name), now=NOW, former_until=NOW)
        with new_imager(tmp_path, name) as one:
            one.outbox.queue_status(
                {"health": health, "disk_free_bytes": 8e10, "clock_error_s": 0.5, "drift_deg": 0.25}
            )
            body = gzip.compress(feed_lines(next_batch(one, name).rows))
            assert hub.put(body, camera=name, token=TOKEN + name).status_code == 200
    fleet = hub.client.get("/v1/fleet").json()["cameras"]
    assert [(one["camera"], one["state"]) for one in fleet] == [
        ("roof", "silent"),
        ("c", "not_ready"),
        ("b", "degraded"),
        ("a", "uncalibrated"),
    ]
    hub.now[0] = NOW + SILENT
    assert [one["state"] for one in hub.client.get("/v1/fleet").json()["cameras"]][1] == "not_ready"
    hub.now[0] = NOW + SILENT + timedelta(seconds=1)
    assert {one["state"] for one in hub.client.get("/v1/fleet").json()["cameras"]} == {"silent"}


def nested(levels: int) -> list[Any]:
    found: list[Any] = []
    for _ in range(levels - 1):
        found = [found]
    return found


UNSHOWABLE: dict[str, list[Any]] = {
    "deep": nested(300),
    "long": ["x" * 1_000_000] * 5,
    "many": ["drift"] * 20_000,
    "no text": ["\ud800"],
}


def others_are_shown(hub: Hub) -> dict[str, Any]:
    for path in ("/", "/metrics", "/v1/quarantine", "/readyz", "/v1/cameras"):
        assert hub.client.get(path).status_code == 200, path
    answer = hub.client.get("/v1/fleet")
    assert answer.status_code == 200
    fleet: dict[str, Any] = {one["camera"]: one for one in answer.json()["cameras"]}
    assert fleet["mast"]["status"] == {"health": "ready", "conditions": []}
    return dict(fleet["roof"])


@pytest.fixture
def with_mast(hub: Hub) -> Hub:
    hub.archive.feeds.add_token("mast", token_digest(TOKEN + "mast"), now=NOW, former_until=NOW)
    good = gzip.compress(b'{"seq": 1, "kind": "status", "data": {"health": "ready", "conditions": []}}\n')
    assert hub.put(good, camera="mast", token=TOKEN + "mast").status_code == 200
    return hub


@pytest.mark.parametrize("kind", UNSHOWABLE)
def test_a_status_that_cannot_be_shown_is_set_apart_and_what_follows_it_is_stored(with_mast: Hub, kind: str) -> None:
    rows = [{"seq": 1, "kind": "status", "data": {"conditions": UNSHOWABLE[kind]}}]
    rows += [{"seq": 2, "kind": "status", "data": {"health": "ready", "free": UNSHOWABLE[kind]}}]
    rows += [{"seq": 3, "kind": "status", "data": {"health": "degraded", "conditions": ["drift"]}}]
    body = gzip.compress("".join(f"{json.dumps(row)}\n" for row in rows).encode())
    answer = with_mast.put(body)
    assert (answer.status_code, answer.json()) == (200, {"committed": 3})
    assert len(with_mast.reasons()) == 2
    assert set(with_mast.reasons()) <= {"body_too_large", "malformed"}
    assert others_are_shown(with_mast)["status"] == {"health": "degraded", "conditions": ["drift"]}


@pytest.mark.parametrize("kind", UNSHOWABLE)
def test_a_camera_whose_stored_status_cannot_be_shown_is_named_and_the_others_are_shown(
    with_mast: Hub, tmp_path: Path, kind: str
) -> None:
    status = json.dumps({"health": "ready", "conditions": UNSHOWABLE[kind]})
    assert (
        with_mast.put(gzip.compress(b'{"seq": 1, "kind": "status", "data": {"health": "ready"}}\n')).status_code == 200
    )
    with closing(sqlite3.connect(tmp_path / "hub.sqlite", isolation_level=None)) as other:
        other.execute("UPDATE fleet SET status = ? WHERE camera = 'roof'", (status,))
    roof = others_are_shown(with_mast)
    assert (roof["state"], roof["status"], roof["why"][0]["code"]) == ("degraded", None, "status_unreadable")


@pytest.mark.parametrize(("levels", "is_stored"), [(32, True), (33, False)])
def test_a_row_may_have_so_many_levels(hub: Hub, levels: int, is_stored: bool) -> None:  # noqa: FBT001
    data = {"more": nested(levels - 1)}
    assert (
        hub.put(gzip.compress(f'{{"seq": 1, "kind": "status", "data": {json.dumps(data)}}}\n'.encode())).status_code
        == 200
    )
    assert (hub.archive.feeds.fleet()[0].status == data, hub.reasons() == []) == (is_stored, is_stored)


def test_every_camera_has_its_numbers_and_the_document_names_them(hub: Hub, tmp_path: Path) -> None:
    with new_imager(tmp_path) as one:
        one.sightings.add([sighting(0)])
        one.outbox.queue_status({"disk_free_bytes": 7, "clock_error_s": 0.5, "drift_deg": 0.25, "health": "ready"})
        hub.put(body_of(one))
    text = hub.client.get("/metrics").text
    assert 'sunarc_fleet_disk_free_bytes{camera="roof"} 7.0' in text
    assert 'sunarc_fleet_state{camera="roof",state="degraded"} 1.0' in text
    found = {line.split(" ")[2] for line in text.splitlines() if line.startswith("# TYPE")}
    assert {name for name in found if name.startswith("sunarc_fleet_")} == METRICS
    assert {"sunarc_push_waiting", "sunarc_http_requests_total", "process_cpu_seconds_total"} <= found
    described = (Path(__file__).parents[2] / "docs" / "fleet.md").read_text()
    assert [name for name in METRICS if f"`{name}`" not in described] == []


def test_the_page_and_the_probes_answer(hub: Hub) -> None:
    assert "fleet.js" in hub.client.get("/").text
    for path in ("/static/fleet.js", "/static/fleet.css", "/healthz", "/readyz", "/openapi.json"):
        assert hub.client.get(path).status_code == 200, path


def test_the_hubs_document_describes_its_routes(hub: Hub) -> None:
    paths = hub.client.get("/openapi.json").json()["paths"]
    for path, method in (("/v1/cameras/{camera}/feed", "put"), ("/v1/fleet", "get"), ("/v1/quarantine", "get")):
        assert json.dumps(paths[path.replace("{camera}", "", 1) if path not in paths else path][method]["description"])


def test_nights_and_summaries_are_answered(hub: Hub, imager: HubArchive) -> None:
    hub.put(body_of(imager))
    day = Day(camera="roof", date=date(2026, 5, 13), verdict="clear", findings=(), n=2, n_possible=3, decided_at=NOW)
    hub.archive.days.save(day)
    hub.archive.nightly.summarise_days()
    hub.archive.nightly.save(NightlyRun(night=date(2026, 5, 14), started_at=NOW, results={"a": {"error": "it broke"}}))
    (run,) = hub.client.get("/v1/nightly").json()["runs"]
    assert (run["night"], run["finished_at"], run["results"]) == ("2026-05-14", None, {"a": {"error": "it broke"}})
    (found,) = hub.client.get("/v1/summaries?camera=roof&since=2026-05-13").json()["days"]
    assert (found["date"], found["n_sightings"]) == ("2026-05-13", 3)
    assert hub.client.get("/v1/summaries?until=2026-05-13").json() == {"days": []}
    assert hub.client.get("/v1/summaries?since=tomorrow").status_code == 422


CHECKS = (
    CrossCheck(
        camera="gate",
        neighbours=("roof",),
        n_days=31,
        found=("slow_turn",),
        since=date(2026, 5, 2),
        clock_s=0.3,
        clock_sigma_s=0.2,
        longitude_deg=0.00125,
        longitude_sigma_deg=0.0008,
        north_deg=0.03,
        north_sigma_deg=0.002,
    ),
    CrossCheck(camera="mast", neighbours=("roof", "gate"), n_days=34, found=()),
    CrossCheck(
        camera="roof",
        neighbours=("gate", "mast", "yard", "pole"),
        n_days=33,
        agreeing=3,
        confidence=0.98,
        found=("clock", "clock_by_clouds"),
        since=date(2026, 5, 9),
        clock_s=2.12,
        clock_sigma_s=0.113,
        longitude_deg=0.00883,
        longitude_sigma_deg=0.00047,
        north_deg=0.0009,
        north_sigma_deg=0.002,
        cloud_clock_s=2.4,
        cloud_clock_sigma_s=0.4,
    ),
)


def save_checks(archive: HubArchive, *checks: CrossCheck, day: int = 14, also: tuple[object, ...] = ()) -> None:
    rows = [*(one.as_json() for one in checks), *also]
    run = NightlyRun(night=date(2026, 5, day), started_at=NOW, results={"cross_checks": {"checks": rows}})
    archive.nightly.save(run)


def test_cross_checks_of_the_newest_night_that_made_some_are_answered_alarms_first(hub: Hub) -> None:
    assert hub.client.get("/v1/cross-checks").json() == {"night": None, "time": None, "checks": []}
    save_checks(hub.archive, day=13)
    newer = ({"camera": "x", "neighbours": [], "n_days": 1, "found": ["a word of later"]}, "no check")
    save_checks(hub.archive, *CHECKS, also=newer)
    failed = NightlyRun(night=date(2026, 5, 15), started_at=NOW, results={"cross_checks": {"error": "it broke"}})
    hub.archive.nightly.save(failed)
    answer = hub.client.get("/v1/cross-checks").json()
    assert answer["night"] == "2026-05-14"
    assert [(one["camera"], one["found"]) for one in answer["checks"]] == [
        ("roof", ["clock", "clock_by_clouds"]),
        ("gate", ["slow_turn"]),
        ("mast", []),
    ]
    roof = answer["checks"][0]
    assert (roof["clock_s"], roof["clock_sigma_s"], roof["since"], roof["neighbours"]) == (
        2.12,
        0.113,
        "2026-05-09",
        ["gate", "mast", "yard", "pole"],
    )
    assert [one["camera"] for one in hub.client.get("/v1/cross-checks?camera=mast").json()["checks"]] == ["mast"]
    assert hub.archive.nightly.cross_checks().checks == (CHECKS[2], CHECKS[0], CHECKS[1])
    assert [one.alarms for one in hub.archive.nightly.cross_checks().checks] == [("clock", "clock_by_clouds"), (), ()]
    assert 'sunarc_fleet_cross_check{camera="roof",found="clock"} 1.0' in hub.client.get("/metrics").text
    (listed,) = hub.client.get("/v1/fleet").json()["cameras"]
    assert listed["state"] == "silent"
    assert [one["code"] for one in listed["why"]] == ["silent", "neighbours_clock", "neighbours_clock_by_clouds"]


def test_a_failed_night_is_a_reason_in_readyz(tmp_path: Path) -> None:
    board = StatusRegistry(version="1", started_at=NOW, monotonic=lambda: 0.0)
    board.set_condition("nightly_failed", Reason(code="nightly_failed", severity="degraded", text="it", remedy="see"))
    make_empty(tmp_path / "hub.sqlite")
    with open_hub_archive(tmp_path / "hub.sqlite") as archive:
        options = ApiOptions(allowed_hosts=("imager",))
        app = create_hub_app(archive=archive, status=board.snapshot, now=lambda: NOW, options=options)
        answer = Client(app).get("/readyz")
    assert (answer.status_code, answer.json()["status"]) == (200, "degraded")
    assert answer.json()["reasons"][0]["code"] == "nightly_failed"


@contextmanager
def small_store(engine: str, disk: Path) -> Iterator[Path | URL]:
    """Yield a store whose tables are on a small disk; of PostgreSQL not its log, without which it would end."""
    if engine == "sqlite":
        make_empty(disk / "hub.sqlite")
        yield disk / "hub.sqlite"
        return
    with running_server() as server:
        shutil.chown(disk, "postgres", "postgres")
        server.sql("postgres", f"CREATE TABLESPACE small LOCATION '{disk}'")
        server.sql("postgres", f"CREATE DATABASE small TEMPLATE {TEMPLATE} TABLESPACE small STRATEGY file_copy")
        yield server.url("small")


def fill(disk: Path) -> Path:
    """Write a file until the disk is full, and return it."""
    filler = disk / "filler"
    with filler.open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(512))
    return filler


@pytest.mark.parametrize("engine", ["sqlite", "postgresql"])
def test_a_hub_whose_disk_is_full_is_not_ready_and_goes_on_when_there_is_room(imager: HubArchive, engine: str) -> None:
    if os.geteuid() != 0:
        pytest.skip("mounting a small disk needs root")
    now = [NOW]
    clock = VirtualClock(NOW)
    board = StatusRegistry(version="1", started_at=NOW, monotonic=clock.monotonic)
    with (
        tempfile.TemporaryDirectory(prefix="disk") as folder,
        mounted(Path(folder), "size=24m", "mode=755"),
        small_store(engine, Path(folder)) as store,
        open_hub_archive(store) as archive,
    ):
        Path(folder).chmod(0o755)
        archive.feeds.add_token("roof", token_digest(TOKEN), now=NOW, former_until=NOW)
        options = ApiOptions(allowed_hosts=("imager",))
        app = create_hub_app(archive=archive, status=board.snapshot, now=lambda: now[0], options=options)
        hub, room = Hub(archive, Client(app), now), StoreRoomWorker(archive=archive, clock=clock, board=board)
        assert hub.put(body_of(imager)).status_code == 200
        assert hub.client.get("/readyz").json()["status"] == "ready"
        imager.outbox.acknowledge(5)
        imager.sightings.add(sighting(n) for n in range(10, 1000))
        filler = fill(Path(folder))
        answer = hub.put(body_of(imager), after=5)
        assert (answer.status_code, answer.headers["retry-after"]) == (503, "5")
        for _ in range(2):
            assert hub.client.get("/readyz").status_code == 503
        room.check()
        assert [(one.code, one.severity) for one in board.snapshot().reasons] == [("store_full", "not_ready")]
        now[0] += timedelta(seconds=6)
        clock.advance(6.0)
        room.check()
        assert hub.client.get("/readyz").json()["errors"][0]["field"] == "store_full"  # tried again
        filler.unlink()
        now[0] += timedelta(seconds=6)
        clock.advance(6.0)
        room.check()
        assert hub.client.get("/readyz").json()["status"] == "ready"
        assert hub.put(body_of(imager), after=5).status_code == 200
        assert len(archive.sightings.find("roof")) == 993
        fill(Path(folder))
        now[0] += timedelta(seconds=61)
        assert hub.client.get("/readyz").status_code == 503  # although nobody sent anything
        assert hub.reasons() == []


@contextmanager
def read_only(server: Server) -> Iterator[None]:
    server.sql("postgres", "ALTER SYSTEM SET default_transaction_read_only = on", "SELECT pg_reload_conf()")
    yield
    server.sql(
        "postgres",
        "SET default_transaction_read_only = off",
        "ALTER SYSTEM RESET default_transaction_read_only",
        "SELECT pg_reload_conf()",
    )


@contextmanager
def table_locked(server: Server) -> Iterator[None]:
    with psycopg.connect(host=str(server.folder), user="test", dbname=TEMPLATE) as other:
        other.execute("LOCK TABLE sun_point IN ACCESS EXCLUSIVE MODE")
        yield


@contextmanager
def inserts_refused(server: Server) -> Iterator[None]:
    server.sql(TEMPLATE, "REVOKE INSERT ON sun_point FROM feeding")
    yield
    server.sql(TEMPLATE, "GRANT INSERT ON sun_point TO feeding")


@contextmanager
def backends_stopped(server: Server) -> Iterator[None]:
    pids = [int(pid) for pid in Path(f"/proc/{server.pid}/task/{server.pid}/children").read_text().split()]
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    yield
    for pid in pids:
        os.kill(pid, signal.SIGCONT)


@pytest.mark.parametrize("fault", [read_only, table_locked, inserts_refused, backends_stopped])
def test_a_hub_that_can_store_nothing_is_not_ready_says_why_and_answers_no_200(
    imager: HubArchive, fault: Callable[[Server], AbstractContextManager[None]]
) -> None:
    if os.geteuid() != 0:
        pytest.skip("stopping another user's processes needs root")
    now = [NOW]
    with running_server() as server:
        server.sql("postgres", "CREATE ROLE feeding LOGIN")
        server.sql(
            TEMPLATE,
            "GRANT SELECT, INSERT, UPDATE ON ALL TABLES IN SCHEMA public TO feeding",
            "GRANT USAGE ON ALL SEQUENCES IN SCHEMA public TO feeding",
            "GRANT DELETE ON quarantine TO feeding",
            "GRANT EXECUTE ON FUNCTION sunarc_require_month(bigint) TO feeding",
        )
        with open_hub_archive(server.url(TEMPLATE, user="feeding")) as archive:
            archive.feeds.add_token("roof", token_digest(TOKEN), now=NOW, former_until=NOW)
            app = create_hub_app(
                archive=archive,
                status=lambda: StatusSnapshot(version="1", started_at=NOW),
                now=lambda: now[0],
                options=ApiOptions(allowed_hosts=("imager",)),
            )
            hub = Hub(archive, Client(app), now)
            assert hub.client.get("/readyz").status_code == 200
            assert hub.put(body_of(imager)).json() == {"committed": 5}
            imager.outbox.acknowledge(5)
            imager.sightings.add([sighting(9)])
            now[0] += timedelta(seconds=11)
            with fault(server):
                for _ in range(2):
                    answer = hub.client.get("/readyz")
                    assert answer.status_code == 503
                    assert "database" in answer.json()["detail"] or "sun_point" in answer.json()["detail"]
                    now[0] += timedelta(seconds=1)
                if fault in {read_only, inserts_refused}:  # the others are waited for
                    assert hub.put(body_of(imager), after=5).status_code == 503
            now[0] += timedelta(seconds=11)
            assert hub.put(body_of(imager), after=5).json() == {"committed": 6}
            assert hub.client.get("/readyz").status_code == 200
            assert (len(archive.sightings.find("roof")), hub.reasons()) == (4, [])


def test_a_hub_whose_file_is_locked_by_another_is_not_ready(hub: Hub, tmp_path: Path) -> None:
    clock = VirtualClock(NOW)
    board = StatusRegistry(version="1", started_at=NOW, monotonic=clock.monotonic)
    room = StoreRoomWorker(archive=hub.archive, clock=clock, board=board)
    room.check()
    assert board.snapshot().reasons == ()
    assert hub.client.get("/readyz").status_code == 200
    with closing(sqlite3.connect(tmp_path / "hub.sqlite", isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        for _ in range(3):
            hub.now[0] += timedelta(seconds=11)
            assert hub.client.get("/readyz").status_code == 503
        clock.advance(12.0)
        room.check()
        assert [(one.code, one.severity) for one in board.snapshot().reasons] == [("store_failed", "not_ready")]
        other.execute("ROLLBACK")
    hub.now[0] += timedelta(seconds=11)
    for _ in range(50):  # the trial that waited has to end
        if hub.client.get("/readyz").status_code == 200:
            return
        hub.now[0] += timedelta(seconds=6)
    pytest.fail("not ready again")
