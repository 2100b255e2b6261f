"""MQTT: notices and the retained state of every camera at a broker, with Home Assistant's discovery."""

from __future__ import annotations

import json
import math
import re
import ssl
import urllib.parse
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any

from sunarc.common.errors import OutsideError
from sunarc.common.extras import extra_module
from sunarc.common.utc import rfc3339
from sunarc.imager.archive.notices import CameraState, Notice
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.workers.options import PushOptions, read_login
from sunarc.imager.workers.push import make_push_message

if TYPE_CHECKING:
    from paho.mqtt.client import Client, MQTTMessageInfo

_ROOT = "sunarc"
_DISCOVERY = "homeassistant"
"""Prefix under which Home Assistant looks for new devices, where nothing else is set there."""
_WITHIN_S = 10.0
"""For a connection, for the receipt of one message, and for the receipts of all states that are under way."""
_TURN_S = 0.1
_REFRESH_S = 5.0
"""For the states of a fleet at once: notices and signs of life come between."""
_UNDER_WAY = 20
"""States that are sent before the first of them is confirmed: 1000 cameras one by one would take 6000 round trips."""
_KEEP_ALIVE_S = 30
"""The broker takes a client for gone, and publishes its last will, after 1.5 times as long without a sign of life."""
_ONLINE, _OFFLINE = "online", "offline"


@dataclass(eq=False)
class MqttBroker:
    """MQTT broker that gets notices, at least once each, and keeps every camera's state.

    The connection is driven by the calls: there is no thread but the worker's. After it was lost a new one begins
    with the states, since a broker may have forgotten what it was to keep.

    Parameters
    ----------
    options : with an address.
    states : returns the cameras as they are, by name.
    clock : real time.
    client : what this service is called at the broker.
    """

    name = "mqtt"

    options: PushOptions
    _: KW_ONLY
    states: Callable[[], Mapping[str, CameraState]]
    clock: Clock
    client: str

    def __post_init__(self) -> None:
        """Read the address; nothing is connected yet."""
        self._mqtt: Any = None
        url = urllib.parse.urlsplit(self.options.mqtt or "")
        tls = url.scheme == "mqtts"
        self._host, self._port = url.hostname or "", url.port or (8883 if tls else 1883)
        self._tls = tls
        self._login_file = self.options.mqtt_login_file
        self._availability = f"{_ROOT}/{topic_name(self.client)}/availability"
        self._connection: Client | None = None
        self._accepted: list[str | None] = []
        self._kept: dict[str, str] = {}
        self._shown: dict[str, CameraState] = {}
        self._heartbeat: Callable[[], None] = lambda: None

    def publish_states(self, heartbeat: Callable[[], None]) -> None:
        """Keep the connection, and publish the changes of the cameras' states; a long message goes on next time."""
        self._heartbeat = heartbeat
        client = self._get_connection()
        self._handle_network(client, 0.0)
        until_s = self.clock.monotonic() + _REFRESH_S
        under_way: deque[MQTTMessageInfo] = deque()
        for camera, state in self.states().items():
            if self._shown.get(camera) == state:
                continue
            if self.clock.monotonic() > until_s:
                break
            for topic, payload in retained(camera, state, availability=self._availability):
                if self._kept.get(topic) != payload:
                    under_way.append(self._send_message(client, topic, payload, retain=True))
                    self._kept[topic] = payload
            self._shown[camera] = state  # where a receipt does not come, the connection and all this is dropped
            while len(under_way) > _UNDER_WAY:
                self._wait_for(client, under_way.popleft(), until_s=until_s + _WITHIN_S)
        for info in under_way:
            self._wait_for(client, info, until_s=until_s + _WITHIN_S)

    def probe(self) -> None:
        """Connect and log in, and end the connection; nothing is published."""
        try:
            client = self._log_in(self._new_client())  # without a last will: the service may be connected meanwhile
            client.disconnect()
            client.loop(_TURN_S)
        finally:
            self.close(graceful=False)

    def deliver(self, notice: Notice, heartbeat: Callable[[], None]) -> None:
        """Publish a notice, and wait for the broker's receipt."""
        self._heartbeat = heartbeat
        self._publish_and_wait(
            self._get_connection(), f"{camera_topic(notice.camera)}/events", json.dumps(make_push_message(notice))
        )

    def close(self, *, graceful: bool) -> None:
        """End the connection: `graceful` after the message that the service is offline; else the broker sends that."""
        client, self._connection = self._connection, None
        self._kept.clear()
        self._shown.clear()
        if client is None:
            return
        if graceful:
            try:
                self._publish_and_wait(client, self._availability, _OFFLINE, retain=True)
                client.disconnect()
                client.loop(_TURN_S)
            except (OutsideError, OSError, ValueError):
                pass
        elif (channel := client.socket()) is not None:
            channel.close()

    def _get_connection(self) -> Client:
        if self._connection is None:
            client = self._new_client()
            client.will_set(self._availability, _OFFLINE, qos=1, retain=True)
            self._publish_and_wait(self._log_in(client), self._availability, _ONLINE, retain=True)
            return client
        return self._connection

    def _log_in(self, client: Client) -> Client:
        try:
            client.connect(self._host, self._port, keepalive=_KEEP_ALIVE_S)
        except (OSError, ValueError) as error:
            raise OutsideError(f"broker {self._host}: {error}") from error
        self._connection = client
        self._wait_until(client, lambda: bool(self._accepted), "did not answer")
        if self._accepted[0] is not None:
            raise OutsideError(f"broker {self._host} refuses: {self._accepted[0]}")
        return client

    def _new_client(self) -> Client:
        self._mqtt = extra_module("paho.mqtt.client", extra="mqtt")
        login = read_login(self._login_file, setting="push.mqtt_login_file")
        client: Client = self._mqtt.Client(self._mqtt.CallbackAPIVersion.VERSION2, protocol=self._mqtt.MQTTv311)
        client.connect_timeout = _WITHIN_S
        if login is not None:
            client.username_pw_set(*login)
        if self._tls:
            client.tls_set_context(ssl.create_default_context())
        accepted: list[str | None] = []
        self._accepted = accepted

        def on_connect(_client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:  # noqa: ANN401 - paho's
            accepted.append(str(reason) if reason.is_failure else None)

        client.on_connect = on_connect
        return client

    def _publish_and_wait(self, client: Client, topic: str, payload: str, *, retain: bool = False) -> None:
        self._wait_for(client, self._send_message(client, topic, payload, retain=retain))

    def _send_message(self, client: Client, topic: str, payload: str, *, retain: bool) -> MQTTMessageInfo:
        info: MQTTMessageInfo = client.publish(topic, payload, qos=1, retain=retain)
        if info.rc != self._mqtt.MQTT_ERR_SUCCESS:
            raise OutsideError(f"broker {self._host}: {self._mqtt.error_string(info.rc)}")
        return info

    def _wait_for(self, client: Client, info: MQTTMessageInfo, *, until_s: float = math.inf) -> None:
        self._wait_until(client, info.is_published, "confirmed no receipt", until_s=until_s)

    def _wait_until(self, client: Client, done: Callable[[], bool], problem: str, *, until_s: float = math.inf) -> None:
        begun_s = self.clock.monotonic()
        while not done():
            self._heartbeat()
            if self.clock.monotonic() > min(begun_s + _WITHIN_S, until_s):
                waited_s = self.clock.monotonic() - begun_s
                raise OutsideError(f"broker {self._host} {problem} within {waited_s:.1f} s")
            self._handle_network(client, _TURN_S)

    def _handle_network(self, client: Client, wait_s: float) -> None:
        """Read and write the pending bytes of the connection once."""
        code = client.loop(wait_s)
        if code != self._mqtt.MQTT_ERR_SUCCESS:
            refusal = next(filter(None, self._accepted), None)
            raise OutsideError(f"broker {self._host}: {refusal or self._mqtt.error_string(code)}")


def topic_name(name: str) -> str:
    """Return a name as a part of a topic: letters, digits, _ and -."""
    return re.sub(r"[^A-Za-z0-9_-]", "_", name)


def camera_topic(camera: str) -> str:
    """Return the topic under which a camera's messages are."""
    return f"{_ROOT}/{topic_name(camera)}"


def retained(camera: str, state: CameraState, *, availability: str) -> Iterator[tuple[str, str]]:
    """Yield the topics that the broker retains, and their payloads: the device's description and the state.

    Parameters
    ----------
    camera, state : whose, and how it is.
    availability : topic of whether the service is connected.
    """
    topic = f"{camera_topic(camera)}/state"
    for component, key, extra in _ENTITIES:
        node = f"{_ROOT}_{topic_name(camera)}"
        described = {
            "unique_id": f"{node}_{key}",
            "object_id": f"{node}_{key}",
            "state_topic": topic,
            "availability_topic": availability,
            "device": {"identifiers": [node], "name": f"Sky imager {camera}", "manufacturer": "sunarc"},
            "origin": {"name": "sunarc"},
            **extra,
        }
        yield f"{_DISCOVERY}/{component}/{node}/{key}/config", json.dumps(described)
    conditions = list(state.conditions.values())
    state_now = {
        "health": state.health,
        "state": state.state,
        "state_text": state.state_text[:255],
        "problem": "ON" if state.health != "ready" else "OFF",
        "conditions": conditions,
        "reasons": "; ".join(str(one.get("text") or one.get("code", "")) for one in conditions)[:255],
        "calibration": state.calibration,
        "calibrated_at": None if state.calibrated_at is None else rfc3339(state.calibrated_at),
        "sky_sigma_deg": state.sky_rms_deg,
    }
    yield topic, json.dumps(state_now)


_ENTITIES: tuple[tuple[str, str, Mapping[str, str]], ...] = (
    (
        "binary_sensor",
        "problem",
        {"name": "Problem", "device_class": "problem", "value_template": "{{ value_json.problem }}"},
    ),
    (
        "sensor",
        "health",
        {"name": "Health", "value_template": "{{ value_json.health }}", "icon": "mdi:heart-pulse"},
    ),
    (
        "sensor",
        "state",
        {"name": "State", "value_template": "{{ value_json.state }}", "icon": "mdi:telescope"},
    ),
    (
        "sensor",
        "state_text",
        {"name": "State in words", "value_template": "{{ value_json.state_text }}"},
    ),
    (
        "sensor",
        "reasons",
        {"name": "Conditions", "value_template": "{{ value_json.reasons }}", "entity_category": "diagnostic"},
    ),
    (
        "sensor",
        "calibrated_at",
        {
            "name": "Calibrated",
            "device_class": "timestamp",
            "value_template": "{{ value_json.calibrated_at }}",
            "entity_category": "diagnostic",
        },
    ),
    (
        "sensor",
        "sky_sigma",
        {
            "name": "Direction uncertainty",
            "unit_of_measurement": "°",
            "state_class": "measurement",
            "value_template": "{{ value_json.sky_sigma_deg }}",
            "entity_category": "diagnostic",
        },
    ),
)
"""Entities of Home Assistant for a camera: component, key, and the rest of its description."""
