"""MQTT, with a real broker that is stopped, killed and started: nothing lost, and the retained state right."""

from __future__ import annotations

import json
import re
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from tests.fixtures.mosquitto import Listener, Mosquitto, broker, retained
from tests.fixtures.pushing import DUSTY, Pushing, pushing, step
from tests.imager.workers.test_webhook import certificate

from sunarc.common.errors import ConfigurationError, OutsideError
from sunarc.imager.archive.notices import CameraState
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.workers import mqtt, push
from sunarc.imager.workers.mqtt import MqttBroker
from sunarc.imager.workers.options import PushOptions

__all__ = ["broker"]
EVENTS, STATE, THERE = "sunarc/roof/events", "sunarc/roof/state", "sunarc/roof/availability"


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Pushing]:
    with pushing(tmp_path) as one:
        yield one


def sink(bench: Pushing, port: int, scheme: str = "mqtt", **options: Any) -> MqttBroker:  # noqa: ANN401 - of PushOptions
    chosen = PushOptions(mqtt=f"{scheme}://127.0.0.1:{port}", **options)
    return MqttBroker(chosen, states=bench.states, clock=bench.clock, client="roof")


def test_messages_and_the_retained_state(bench: Pushing, broker: Mosquitto) -> None:
    listener = Listener(broker.port, EVENTS)
    worker = bench.worker(sink(bench, broker.port))
    bench.look("mqtt")
    bench.happen(3, "mqtt")
    assert step(worker) == 1.0
    bench.conditions["dusty"] = DUSTY
    bench.look("mqtt")
    step(worker)
    listener.wait_for(4)
    assert [message["type"] for message in listener.of(EVENTS)] == ["bump"] * 3 + ["condition_set"]
    assert [message["data"].get("text") for message in listener.of(EVENTS)][:3] == ["0", "1", "2"]
    kept = retained(broker.port)
    assert kept[THERE] == "online"
    assert (kept[STATE]["health"], kept[STATE]["problem"], kept[STATE]["conditions"]) == ("degraded", "ON", [DUSTY])
    assert EVENTS not in kept
    worker.sink.close(graceful=True)
    assert retained(broker.port)[THERE] == "offline"
    listener.close()


@pytest.mark.parametrize("kill", [False, True])
def test_a_broker_that_is_stopped_and_started_loses_nothing(bench: Pushing, broker: Mosquitto, *, kill: bool) -> None:
    worker = bench.worker(sink(bench, broker.port))
    bench.look("mqtt")
    listener = Listener(broker.port, EVENTS)
    bench.happen(2, "mqtt")
    step(worker)
    listener.wait_for(2)
    broker.stop(kill=kill)
    bench.conditions["dusty"] = DUSTY
    bench.happen(3, "mqtt")
    assert [step(worker) for _ in range(3)] == [1.0, 2.0, 4.0]
    bench.conditions.clear()
    bench.look("mqtt")
    broker.start()
    after = Listener(broker.port, EVENTS)
    assert step(worker) == 1.0
    after.wait_for(5)
    after.listen(0.2)
    told = [(message["type"], message["data"].get("text")) for message in after.of(EVENTS)]
    bumps = [("bump", str(number)) for number in range(3)]
    assert told == [*bumps, ("condition_set", DUSTY["text"]), ("condition_cleared", DUSTY["text"])]
    # a broker without a disk has forgotten all that it kept
    kept = retained(broker.port)
    assert (kept[STATE]["health"], kept[THERE]) == ("ready", "online")
    assert len([topic for topic in kept if topic.startswith("homeassistant/")]) == 7
    worker.sink.close(graceful=False)
    after.close()


def test_a_service_that_is_killed_goes_on_where_it_was(bench: Pushing, broker: Mosquitto) -> None:
    listener = Listener(broker.port, EVENTS, THERE)
    bench.look("mqtt")
    bench.happen(2, "mqtt")
    first = bench.worker(sink(bench, broker.port))
    step(first)
    first.sink.close(graceful=False)  # as the kernel closes what a process had
    listener.wait_for(4)
    assert listener.of(THERE)[-1] == "offline"  # the last will
    bench.restart()
    bench.happen(2, "mqtt")
    second = bench.worker(sink(bench, broker.port))
    step(second)
    listener.wait_for(7)
    listener.listen(0.2)
    assert [message["data"]["text"] for message in listener.of(EVENTS)] == ["0", "1", "0", "1"]
    assert len({message["id"] for message in listener.of(EVENTS)}) == 4
    assert listener.of(THERE)[-1] == "online"
    second.sink.close(graceful=True)
    listener.close()


def test_a_receipt_that_is_lost_doubles_one_message_under_its_id(
    bench: Pushing, broker: Mosquitto, monkeypatch: pytest.MonkeyPatch
) -> None:
    listener = Listener(broker.port, EVENTS)
    bench.look("mqtt")
    bench.happen(2, "mqtt")
    worker = bench.worker(sink(bench, broker.port))
    with monkeypatch.context() as patched:
        patched.setattr(bench.archive.notices, "done", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):  # killed between the receipt and the note of it
            step(worker)
    worker.sink.close(graceful=False)
    step(bench.worker(sink(bench, broker.port)))
    listener.wait_for(3)
    ids = [message["id"] for message in listener.of(EVENTS)]
    assert len(ids) == 3
    assert ids[0] == ids[1] != ids[2]
    listener.close()


def test_an_idle_connection_is_kept_and_states_are_sent_when_they_change(bench: Pushing, broker: Mosquitto) -> None:
    listener = Listener(broker.port, STATE, THERE)
    bench.look("mqtt")
    worker = bench.worker(sink(bench, broker.port))
    for _ in range(4):
        bench.look("mqtt")
        step(worker)
    listener.listen(0.2)
    assert [topic for topic, _, _ in listener.heard] == [THERE, STATE]
    worker.sink.close(graceful=True)
    listener.close()


def password(folder: Path, *lines: str) -> Mosquitto:
    subprocess.run(["mosquitto_passwd", "-b", "-c", folder / "passwords", "sunarc", "word"], check=True)
    (folder / "passwords").chmod(0o600)
    return Mosquitto(folder, f"password_file {folder / 'passwords'}", "allow_anonymous false", *lines)


def test_a_login_is_refused_and_taken(bench: Pushing, broker: Mosquitto, monkeypatch: pytest.MonkeyPatch) -> None:
    del broker  # without mosquitto this is skipped there
    monkeypatch.setattr(push, "_FAILING_S", 0.0)
    locked, login = password(bench.folder), bench.folder / "login"
    locked.start()
    bench.look("mqtt")
    bench.happen(1, "mqtt")
    for text, codes in (("sunarc:wrong", {"push_failing_mqtt"}), ("sunarc:word", set())):
        login.write_text(text)
        worker = bench.worker(sink(bench, locked.port, mqtt_login_file=login))
        step(worker)
        assert bench.codes() == codes
        if codes:
            (reason,) = bench.board.snapshot().reasons
            assert "Not authorized" in str(reason.data["error"])
        worker.sink.close(graceful=True)
    locked.stop()


# paho leaves a connection whose certificate is refused to the garbage collector
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_certificate_is_checked(bench: Pushing, broker: Mosquitto, monkeypatch: pytest.MonkeyPatch) -> None:
    del broker
    monkeypatch.setattr(push, "_FAILING_S", 0.0)
    certificate(bench.folder)
    files = (f"certfile {bench.folder / 'cert.pem'}", f"keyfile {bench.folder / 'key.pem'}", "allow_anonymous true")
    sealed = Mosquitto(bench.folder, *files)
    sealed.start()
    bench.look("mqtt")
    bench.happen(1, "mqtt")
    step(bench.worker(sink(bench, sealed.port, "mqtts")))
    (reason,) = bench.board.snapshot().reasons
    assert "CERTIFICATE_VERIFY_FAILED" in str(reason.data["error"])
    monkeypatch.setenv("SSL_CERT_FILE", str(bench.folder / "cert.pem"))
    worker = bench.worker(sink(bench, sealed.port, "mqtts"))
    step(worker)
    assert (bench.codes(), bench.archive.notices.sink_states()["mqtt"].waiting) == (set(), 0)
    worker.sink.close(graceful=True)
    sealed.stop()


def test_a_broker_that_answers_nothing_holds_up_nobody(bench: Pushing, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt, "_WITHIN_S", 0.3)
    bench.look("mqtt")
    bench.happen(1, "mqtt")
    with socket.create_server(("127.0.0.1", 0)) as silent:
        worker = bench.worker(sink(bench, silent.getsockname()[1]))
        begun_s = bench.clock.monotonic()
        assert step(worker) == 1.0
        assert bench.clock.monotonic() - begun_s < 2.0


def confirming_slowly(listening: socket.socket, every_s: float) -> None:
    """Accept a client, and confirm one of its messages (MQTT 3.1.1, at least once) at a time, one every `every_s`."""
    channel, _ = listening.accept()
    received = bytearray()
    waiting = threading.Event()

    def read() -> None:
        with suppress(OSError):
            while part := channel.recv(65_536):
                received.extend(part)

    with channel:
        threading.Thread(target=read, daemon=True).start()
        channel.sendall(b"\x20\x02\x00\x00")  # the client is accepted
        with suppress(OSError):
            for number in range(1, 100):
                channel.sendall(b"\x40\x02" + number.to_bytes(2, "big"))  # message `number` was received
                if number > 1:  # the first says that the client is there
                    waiting.wait(every_s)


def test_a_broker_that_confirms_slowly_holds_up_nobody(bench: Pushing, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each receipt comes just in time, and there are twenty of them."""
    monkeypatch.setattr(mqtt, "_WITHIN_S", 0.5)
    monkeypatch.setattr(mqtt, "_REFRESH_S", 0.2)
    states = {f"c{n}": CameraState(health="ready", state="ready", state_text="ready") for n in range(40)}
    beats: list[float] = []
    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=confirming_slowly, args=(listening, 0.4), daemon=True).start()
        broker = MqttBroker(
            PushOptions(mqtt=f"mqtt://127.0.0.1:{listening.getsockname()[1]}"),
            states=lambda: states,
            clock=bench.clock,
            client="hub",
        )
        begun_s = bench.clock.monotonic()
        with pytest.raises(OutsideError):
            broker.publish_states(lambda: beats.append(bench.clock.monotonic()))
        assert bench.clock.monotonic() - begun_s < 2.0
        broker.close(graceful=False)
    assert max(later - former for former, later in pairwise([begun_s, *beats])) < 0.5


@pytest.mark.parametrize("text", ["", "sunarc", ":word"])
def test_a_login_that_is_none_is_a_condition_until_it_is_one(bench: Pushing, broker: Mosquitto, text: str) -> None:
    (bench.folder / "login").write_text(text)
    worker = bench.worker(sink(bench, broker.port, mqtt_login_file=bench.folder / "login"))
    with pytest.raises(ConfigurationError):
        worker.sink.probe()
    assert (step(worker), bench.codes()) == (60.0, {"push_unusable_mqtt"})
    (bench.folder / "login").write_text("sunarc:word")
    assert (step(worker), bench.codes()) == (1.0, set())
    worker.sink.close(graceful=False)


def test_a_missing_library_is_a_condition(bench: Pushing, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "paho.mqtt.client", None)
    worker = bench.worker(sink(bench, 1883))
    assert (step(worker), bench.codes()) == (60.0, {"push_unusable_mqtt"})


def test_a_probe_leaves_what_the_running_service_shows(bench: Pushing, broker: Mosquitto) -> None:
    worker = bench.worker(sink(bench, broker.port))
    bench.look("mqtt")
    step(worker)
    before = retained(broker.port)
    sink(bench, broker.port).probe()
    assert retained(broker.port) == before
    assert before[THERE] == "online"
    worker.sink.close(graceful=False)


def test_the_announcement_to_home_assistant_has_what_it_needs() -> None:
    """By its documentation: topics, a unique id, a device, and templates over the JSON of the state."""
    state = CameraState(
        health="ready", state="ready", state_text="ready", calibration="c", calibrated_at=None, sky_rms_deg=0.01
    )
    *entities, (topic, told) = mqtt.retained("a roof/1", replace(state), availability=THERE)
    assert topic == "sunarc/a_roof_1/state"
    fields = json.loads(told)
    ids, devices = set(), set()
    for name, text in entities:
        described = json.loads(text)
        assert re.fullmatch(r"homeassistant/(sensor|binary_sensor)/[a-zA-Z0-9_-]+/[a-zA-Z0-9_-]+/config", name)
        assert (described["state_topic"], described["availability_topic"]) == (topic, THERE)
        (field,) = re.findall(r"\{\{ value_json\.(\w+) \}\}", described["value_template"])
        assert field in fields
        ids.add(described["unique_id"])
        devices.add(tuple(described["device"]["identifiers"]))
    assert (len(ids), len(devices)) == (7, 1)


def test_a_worker_runs_and_stops(bench: Pushing, broker: Mosquitto) -> None:
    bench.look("mqtt")
    stop = threading.Event()
    thread = threading.Thread(target=bench.worker(sink(bench, broker.port)).run, args=(stop, lambda: None))
    listener = Listener(broker.port, THERE)
    thread.start()
    listener.wait_for(1)
    stop.set()
    listener.wait_for(2)
    thread.join(5.0)
    assert listener.of(THERE) == ["online", "offline"]
    listener.close()


class Distance:
    """A way to a broker on which every part takes its time."""

    def __init__(self, port: int, delay_s: float) -> None:
        self._delay_s = delay_s
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self._broker = socket.create_connection(("127.0.0.1", port))
        self._thread = threading.Thread(target=self._accept, daemon=True)
        self._thread.start()

    def _accept(self) -> None:
        client, _ = self._listening.accept()
        with client, self._broker:
            ways = [
                threading.Thread(target=self._carry, args=ends, daemon=True)
                for ends in ((client, self._broker), (self._broker, client))
            ]
            for way in ways:
                way.start()
            for way in ways:
                way.join()

    def _carry(self, source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while part := source.recv(65_536):
                threading.Event().wait(self._delay_s)
                target.sendall(part)
        with suppress(OSError):
            target.shutdown(socket.SHUT_WR)

    def close(self) -> None:
        self._thread.join(10.0)
        self._listening.close()


def test_the_states_of_a_fleet_do_not_wait_for_one_another(bench: Pushing, broker: Mosquitto) -> None:
    states = {f"c{n}": CameraState(health="ready", state="ready", state_text="ready") for n in range(40)}
    distance = Distance(broker.port, 0.02)
    far = MqttBroker(
        PushOptions(mqtt=f"mqtt://127.0.0.1:{distance.port}"), states=lambda: states, clock=bench.clock, client="hub"
    )
    begun_s = bench.clock.monotonic()
    far.publish_states(lambda: None)
    assert bench.clock.monotonic() - begun_s < 4.0  # 240 messages one by one take 9.6 s on the way alone
    far.close(graceful=False)
    distance.close()
    kept = retained(broker.port)
    assert [kept[f"sunarc/c{n}/state"]["health"] for n in range(40)] == ["ready"] * 40


def test_states_that_take_long_go_on_at_the_next_call_and_equal_ones_are_not_looked_at_again(
    broker: Mosquitto, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = VirtualClock(datetime(2026, 6, 1, tzinfo=UTC))
    states = {f"c{n}": CameraState(health="ready", state="ready", state_text="ready") for n in range(5)}
    made: list[str] = []

    def slowly(camera: str, state: CameraState, *, availability: str) -> Iterator[tuple[str, str]]:
        made.append(camera)
        clock.advance(2.0)
        yield f"{camera}/{availability}", state.health

    monkeypatch.setattr(mqtt, "retained", slowly)
    near = MqttBroker(
        PushOptions(mqtt=f"mqtt://127.0.0.1:{broker.port}"), states=lambda: states, clock=clock, client="hub"
    )
    near.publish_states(lambda: None)
    assert made == ["c0", "c1", "c2"]  # 5 s were over
    near.publish_states(lambda: None)
    near.publish_states(lambda: None)
    assert made == ["c0", "c1", "c2", "c3", "c4"]
    states["c1"] = CameraState(health="degraded", state="attention", state_text="lost")
    near.publish_states(lambda: None)
    assert made[5:] == ["c1"]
    near.close(graceful=True)
    near.publish_states(lambda: None)  # another connection begins with all
    assert made[6:] == ["c0", "c1", "c2"]
    near.close(graceful=True)
