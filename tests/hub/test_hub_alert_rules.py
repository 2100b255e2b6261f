"""Each rule of the hub's alert rules: a fault is done, and its /metrics is what Prometheus's promtool sees."""

from __future__ import annotations

import gzip
import json
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from datetime import timedelta
from pathlib import Path

import pytest
from tests.fixtures.fleet import NOW, new_imager, next_batch, sighting
from tests.fixtures.postgresql import Server, running_server
from tests.fixtures.served import Client
from tests.hub.test_hub import TOKEN, Hub

from sunarc.hub.archive import HubArchive, open_hub_archive
from sunarc.hub.feed_routes import token_digest
from sunarc.hub.serving import create_hub_app
from sunarc.imager.archive.feed_rows import feed_lines
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import Reason, StatusRegistry
from sunarc.imager.web.options import ApiOptions

RULES = Path(__file__).parents[2] / "deploy" / "hub" / "prometheus-rules.yml"
needs_promtool = pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool is not installed")


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    """Yield a server that one test stops."""
    with running_server() as running:
        yield running


@pytest.fixture
def board() -> StatusRegistry:
    return StatusRegistry(version="1", started_at=NOW, monotonic=VirtualClock(NOW).monotonic)


@pytest.fixture
def hub(server: Server, board: StatusRegistry) -> Iterator[Hub]:
    """Yield a hub on PostgreSQL that has a healthy camera's rows."""
    now = [NOW]
    with open_hub_archive(server.emptied_database()) as archive:
        archive.feeds.add_token("roof", token_digest(TOKEN), now=NOW, former_until=NOW)
        options = ApiOptions(allowed_hosts=("imager",))
        app = create_hub_app(archive=archive, status=board.snapshot, now=lambda: now[0], options=options)
        yield Hub(archive, Client(app), now)


@pytest.fixture
def imager(tmp_path: Path, hub: Hub) -> Iterator[HubArchive]:
    with new_imager(tmp_path) as archive:
        archive.sightings.add(sighting(n) for n in range(3))
        archive.outbox.queue_status({"health": "ready"})
        send(hub, archive)
        yield archive


def send(hub: Hub, imager: HubArchive) -> None:
    batch = next_batch(imager)
    put(hub, feed_lines(batch.rows), after=batch.after, installation=batch.installation)
    imager.outbox.acknowledge(batch.rows[-1].seq)


def put(hub: Hub, lines: bytes, *, after: int, installation: str) -> None:
    answer = hub.put(gzip.compress(lines), after=after, installation=installation)
    assert answer.status_code == 200, answer.text


def alerts(hub: Hub, folder: Path, *, up: int = 1) -> set[str]:
    """Return the alerts that an hour of what the hub exports makes fire."""
    text = hub.client.get("/metrics").text
    samples = re.findall(r"^(sunarc_\w+)(?:\{(.*)\})? ([0-9.e+-]+)$", text, re.MULTILINE)
    where = 'instance="hub:8080",job="sunarc-hub"'
    series = {f"{name}{{{labels + ',' if labels else ''}{where}}}": f"{value}x60" for name, labels, value in samples}
    series[f"up{{{where}}}"] = f"{up}x60"
    names = re.findall(r"alert: (\w+)", RULES.read_text())
    test = {
        "rule_files": [str(RULES)],
        "evaluation_interval": "1m",
        "tests": [
            {
                "interval": "1m",
                "input_series": [{"series": name, "values": values} for name, values in series.items()],
                "alert_rule_test": [{"eval_time": "60m", "alertname": name, "exp_alerts": []} for name in names],
            }
        ],
    }
    file = folder / "test.yml"
    file.write_text(json.dumps(test))
    done = subprocess.run(["promtool", "test", "rules", file], capture_output=True, text=True, check=False)
    said = done.stdout + done.stderr
    assert "SUCCESS" in said or "got:[" in said, said
    return set(re.findall(r"alertname=\"(\w+)\"", said)) if done.returncode else set()


def quarantined(hub: Hub, imager: HubArchive, _board: StatusRegistry) -> None:
    position = imager.outbox.position()
    row = {"seq": position.committed + 1, "kind": "sun_point", "data": {"nonsense": 1}}
    lines = json.dumps(row).encode() + b"\n"
    put(hub, lines, after=position.committed, installation=position.installation)


def silent(hub: Hub, _imager: HubArchive, _board: StatusRegistry) -> None:
    hub.now[0] = NOW + timedelta(minutes=16)


def behind(hub: Hub, imager: HubArchive, _board: StatusRegistry) -> None:
    """Send rows of an outage for a quarter of an hour: the imager's report of itself stands behind them."""
    for minutes in range(17):
        hub.now[0] = NOW + timedelta(minutes=minutes)
        imager.sightings.add([sighting(10 + minutes)])
        send(hub, imager)


def failing(_hub: Hub, _imager: HubArchive, board: StatusRegistry) -> None:
    board.set_condition("nightly_failed", Reason(code="nightly_failed", severity="degraded", text="t", remedy="r"))


FAULTS = {
    "SunarcHubQuarantine": quarantined,
    "SunarcHubCameraSilent": silent,
    "SunarcHubFeedBehind": behind,
    "SunarcHubDegraded": failing,
}


@needs_promtool
@pytest.mark.parametrize("alert", FAULTS)
def test_an_alert_fires_on_its_fault_alone(
    hub: Hub, imager: HubArchive, board: StatusRegistry, tmp_path: Path, alert: str
) -> None:
    assert alerts(hub, tmp_path) == set()
    fault: Callable[[Hub, HubArchive, StatusRegistry], None] = FAULTS[alert]
    fault(hub, imager, board)
    assert alerts(hub, tmp_path) == {alert}


@needs_promtool
@pytest.mark.usefixtures("imager")
def test_a_database_that_is_away_is_an_alert_and_the_numbers_are_answered(
    hub: Hub, server: Server, tmp_path: Path
) -> None:
    server.stop()
    try:
        assert alerts(hub, tmp_path) == {"SunarcHubStoreDown"}
        text = hub.client.get("/metrics").text
        assert "sunarc_store_up 0.0" in text
        assert 'sunarc_health{state="ready"} 1.0' in text
    finally:
        server.start()
    assert alerts(hub, tmp_path) == set()


@needs_promtool
@pytest.mark.usefixtures("imager")
def test_a_hub_that_does_not_answer_is_an_alert(hub: Hub, tmp_path: Path) -> None:
    assert alerts(hub, tmp_path, up=0) == {"SunarcHubDown"}


def test_every_rule_has_a_fault() -> None:
    named = re.findall(r"alert: (\w+)", RULES.read_text())
    assert sorted(named) == sorted([*FAULTS, "SunarcHubStoreDown", "SunarcHubDown"])


@pytest.mark.usefixtures("imager")
def test_every_number_that_the_rules_read_is_exported(hub: Hub, imager: HubArchive, board: StatusRegistry) -> None:
    failing(hub, imager, board)
    text = hub.client.get("/metrics").text
    read = set(re.findall(r"sunarc_\w+", " ".join(re.findall(r"expr: (.*)", RULES.read_text()))))
    assert len(read) >= 5
    assert [name for name in read if f"# TYPE {name} " not in text] == []
