"""How the service joins its parts: which workers there are, what is handed to which, and what a fault leaves."""

from __future__ import annotations

import signal
import threading
import urllib.request
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import uvicorn
from tests.fixtures.archive import HIDDEN, store_sun_point
from tests.fixtures.cameras import INFO
from tests.fixtures.settings import new_settings

from sunarc.cli import simulate as simulate_command
from sunarc.common.errors import ConfigurationError, OutsideError
from sunarc.detection.values import Detection
from sunarc.imager.app import serving
from sunarc.imager.app.cameras import camera_opener, camera_record
from sunarc.imager.app.service import Service, make_recording_workers
from sunarc.imager.app.serving import Server, daily_schedule, load_credentials, monitored_parts, serve_imager
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.archive.pictures_of_one_time import ELSEWHERE
from sunarc.imager.cameras.frame import CameraCondition, CameraInfo, Frame
from sunarc.imager.runtime.clock import ClockState, VirtualClock
from sunarc.imager.runtime.host import listen
from sunarc.imager.runtime.status import DiskStatus, Reason
from sunarc.imager.runtime.supervisor import Heartbeat
from sunarc.imager.settings.model import Settings
from sunarc.imager.workers.push import webhook_name
from sunarc.imager.workers.upkeep import ConditionTimesWorker, HousekeepingWorker
from sunarc.lab.simulation import serving as simulating
from sunarc.lab.simulation.imager import ImagerOptions

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
FRAME = Frame(
    image=np.zeros((6, 8), dtype=np.uint16), time=NOON, exposure_us=20.0, gain_db=0.0, pixel_format="Mono12",
    full_scale=4095, frame_id=1,
)  # fmt: skip
FOUND = Detection(method="disc", accepted=True, verdict="clear", findings=(), x_px=3.0, y_px=2.0, sigma_px=0.1)
CAMERA = {"address": "127.0.0.9", "timestamps": "host"}


class OpenCamera:
    def __init__(self, info: CameraInfo = INFO) -> None:
        self.info = info
        self.closed = False

    def expose(self, exposure_us: float) -> Frame:
        raise AssertionError(exposure_us)

    def distrust(self) -> None: ...

    def check(self) -> CameraCondition:
        return CameraCondition()

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def camera() -> OpenCamera:
    return OpenCamera()


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock(NOON)


def made(settings: Settings, camera: OpenCamera, clock: VirtualClock) -> Service:
    upgrade(settings.database)
    return Service(settings, archive=open_archive(settings.database), clock=clock, open_camera=lambda: camera)


@pytest.fixture
def service(tmp_path: Path, camera: OpenCamera, clock: VirtualClock) -> Iterator[Service]:
    running = made(new_settings(tmp_path, camera=CAMERA), camera, clock)
    yield running
    running.archive.close()


@pytest.fixture
def replay(tmp_path: Path, camera: OpenCamera, clock: VirtualClock) -> Iterator[Service]:
    settings = new_settings(tmp_path, source="replay", replay={"folder": tmp_path / "images"})
    running = made(settings, camera, clock)
    yield running
    running.archive.close()


def test_consumers_start_before_the_camera_that_feeds_them(service: Service) -> None:
    names = [worker.name for worker in service.workers()]
    assert names == ["clock", "disk", "database", "refit", "watch", "detect", "compose", "capture"]


def test_without_capture_the_service_ends_and_without_detection_it_is_not_ready(service: Service) -> None:
    workers = {worker.name: worker for worker in service.workers()}
    assert [name for name, worker in workers.items() if worker.essential] == ["capture"]
    assert {name for name, worker in workers.items() if worker.severity == "not_ready"} == {"capture", "detect"}


def test_only_what_sends_to_others_or_tries_the_store_is_optional(
    tmp_path: Path, camera: OpenCamera, clock: VirtualClock
) -> None:
    (tmp_path / "secret").write_text("0123456789abcdef")
    push = {"webhooks": ["http://127.0.0.1:9/"], "webhook_secret_file": tmp_path / "secret", "mqtt": "mqtt://127.0.0.1"}
    hub = {"url": "http://127.0.0.1:9", "token_file": tmp_path / "secret"}
    running = made(new_settings(tmp_path, camera=CAMERA, hub=hub, push=push), camera, clock)
    workers = (*running.workers(), *make_recording_workers(running), *serving.make_push_workers(running))
    running.archive.close()
    sending = {"feed", "notices", "push_mqtt", f"push_{webhook_name('http://127.0.0.1:9/')}"}
    assert {worker.name for worker in workers if worker.optional} == {*sending, "room"}


def test_a_replay_takes_the_cameras_place_and_no_other_workers(service: Service, replay: Service) -> None:
    kinds = [[type(worker.make_worker()).__name__ for worker in one.workers()] for one in (service, replay)]
    assert kinds[0][:-1] == kinds[1][:-1]
    assert [one[-1] for one in kinds] == ["CaptureWorker", "ReplayWorker"]


def test_a_replay_has_no_slots_that_are_due(replay: Service, clock: VirtualClock) -> None:
    for _ in range(20):
        clock.advance(replay.settings.capture.cadence_s)
        replay.check_sightings()
    assert "no_sightings" not in {reason.code for reason in replay.board.snapshot().reasons}


@pytest.mark.parametrize(
    ("changes", "noticed"),
    [
        ({}, True),
        ({"accepted": False, "verdict": ELSEWHERE}, True),
        ({"accepted": False, "verdict": "hidden"}, False),
        ({"accepted": False, "verdict": ELSEWHERE, "x_px": None}, False),
    ],
)
def test_the_watch_gets_every_sun_with_a_pixel_and_nothing_else(
    service: Service, monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any], *, noticed: bool
) -> None:
    seen: list[datetime] = []
    monkeypatch.setattr(service.watch, "notice", lambda at, **_: seen.append(at))
    service.report(FRAME, replace(FOUND, **changes))
    assert seen == ([NOON] if noticed else [])


def test_the_watch_gets_nothing_while_the_clock_is_not_trusted(
    service: Service, clock: VirtualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[datetime] = []
    monkeypatch.setattr(service.watch, "notice", lambda at, **_: seen.append(at))
    clock.set_state(ClockState(synchronised=False, error_bound_s=16.0))
    service.report(FRAME, FOUND)
    assert seen == []


def test_a_database_that_cannot_be_read_leaves_the_level_of_the_sun_unknown(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> float:
        raise OutsideError("disk I/O error")

    monkeypatch.setattr(type(service.predictor), "clear_level_per_us", refuse)
    assert service._clear_level_per_us() == 0.0


def test_a_camera_is_stored_when_it_is_opened(service: Service, camera: OpenCamera) -> None:
    assert service.open_and_remember() is camera
    (stored,) = service.archive.cameras.all()
    assert (stored.name, stored.width, stored.height, stored.model) == ("roof", 8, 6, "Test Sky")


def test_a_disk_that_refuses_the_record_does_not_keep_the_camera_from_its_work(
    service: Service, camera: OpenCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OutsideError("disk is full")

    monkeypatch.setattr(type(service.archive.cameras), "save", refuse)
    assert service.open_and_remember() is camera
    assert not camera.closed


def test_while_the_clock_is_not_trusted_a_change_is_dated_just_after_the_newest_sighting(
    service: Service, clock: VirtualClock
) -> None:
    service.open_and_remember()
    store_sun_point(service.archive, NOON, clock_error_s=0.0, **HIDDEN)
    clock.advance(3600.0)
    assert service._change_time() == NOON + timedelta(hours=1)
    clock.set_state(ClockState(synchronised=False, error_bound_s=16.0))
    assert service._change_time() == NOON + timedelta(microseconds=1)


@pytest.mark.parametrize("source", ["aravis", "replay"])
def test_a_source_without_its_section_is_refused(tmp_path: Path, clock: VirtualClock, source: str) -> None:
    with pytest.raises(ConfigurationError):
        camera_opener(new_settings(tmp_path, source=source), clock)


@pytest.mark.parametrize(("vendor", "model", "stored"), [("Test", "Sky", "Test Sky"), ("", "Sky", "Sky"), ("", "", "")])
def test_the_stored_model_is_the_vendors_and_the_models_name(vendor: str, model: str, stored: str) -> None:
    info = replace(INFO, vendor=vendor, model=model)
    assert camera_record(info, name="roof", site=ImagerOptions().site).model == stored


def test_tokens_of_systemd_are_used_where_no_file_is_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("api-token", "api-read-token"):
        (tmp_path / name).write_text("token-of-systemd-0123456789")
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    options = load_credentials(new_settings(tmp_path).api)
    assert (options.token_file, options.read_token_file) == (tmp_path / "api-token", tmp_path / "api-read-token")
    own = replace(options, token_file=tmp_path / "own")
    assert load_credentials(own).token_file == tmp_path / "own"


def test_the_web_servers_loop_and_the_schedule_are_watched(service: Service) -> None:
    config = uvicorn.Config(lambda *_: None, lifespan="off", log_level="warning")
    server = Server(config, on_started=lambda: None, heartbeat=Heartbeat(service.clock.monotonic))
    web, schedule = monitored_parts(service, server=server, schedule=daily_schedule(service))
    assert (web.name, web.stale_after_s) == ("web", 30.0)
    assert (schedule.name, schedule.stale_after_s) == ("schedule", service.settings.refit.check_every_s + 600.0)


def test_the_service_runs_until_it_is_told_to_stop_and_frees_its_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A replay of an empty folder: its camera fails, the web server answers, SIGTERM ends it with 0."""
    handlers = {one: signal.getsignal(one) for one in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)}
    (tmp_path / "images").mkdir()
    ports: list[int] = []

    def listening(host: str, port: int) -> Any:  # noqa: ANN401 - a socket
        opened = listen(host, port)
        ports.append(opened.getsockname()[1])
        bound.set()
        return opened

    def stop_once_it_answers() -> None:
        bound.wait(20.0)
        for _ in range(1000):
            with suppress(OSError), urllib.request.urlopen(f"http://127.0.0.1:{ports[0]}/v1/status") as answer:
                statuses.append(answer.status)
                break
            ended.wait(0.02)
        if not ended.is_set():
            signal.raise_signal(signal.SIGTERM)

    bound, ended, statuses = threading.Event(), threading.Event(), list[int]()
    monkeypatch.setattr(serving, "listen", listening)
    settings = new_settings(
        tmp_path, source="replay", replay={"folder": tmp_path / "images"}, api={"host": "127.0.0.1", "port": 0}
    )
    thread = threading.Thread(target=stop_once_it_answers)
    try:
        thread.start()
        assert serve_imager(settings) == 0
    finally:
        ended.set()
        thread.join()
        for one, handler in handlers.items():
            signal.signal(one, handler)
    assert statuses == [200]
    assert "sunarc.sqlite" in {path.name for path in settings.state.iterdir()}


def test_the_simulated_imager_gets_what_the_command_was_given(monkeypatch: pytest.MonkeyPatch) -> None:
    runs: list[ImagerOptions] = []
    handlers = {one: signal.getsignal(one) for one in (signal.SIGTERM, signal.SIGINT)}
    monkeypatch.setattr(simulating, "run_imager", lambda options, *_, **__: runs.append(options))
    monkeypatch.setattr(simulate_command, "start_log", lambda _: None)
    try:
        simulate_command.simulate(
            address="127.0.0.3", start=NOON.isoformat(), speed=60.0, lens_seed=4, clouds="veil",
            nd_transmission=0.02, ghost=0.1, sun_cover=0.3, blooming=0.4, moon=(40.0, 120.0),
        )  # fmt: skip
    finally:
        for one, handler in handlers.items():
            signal.signal(one, handler)
    (options,) = runs
    assert (options.address, options.start, options.speed, options.lens_seed) == ("127.0.0.3", NOON, 60.0, 4)
    assert (options.scene.nd_transmission, options.scene.ghost_strength, options.scene.sun_cover) == (0.02, 0.1, 0.3)
    assert (options.sensor.blooming, options.scene.moon_at, options.clouds) == (0.4, (40.0, 120.0), "veil")


def test_what_is_recorded_goes_on_over_a_restart(tmp_path: Path, camera: OpenCamera, clock: VirtualClock) -> None:
    low = Reason(code="disk_low", severity="degraded", text="full", remedy="free some space")
    since: list[datetime | None] = []
    for _ in range(2):
        running = made(new_settings(tmp_path, camera=CAMERA), camera, clock)
        recording = {worker.name: worker.make_worker() for worker in make_recording_workers(running)}
        housekeeping, conditions = recording["housekeeping"], recording["conditions"]
        assert isinstance(housekeeping, HousekeepingWorker)
        assert isinstance(conditions, ConditionTimesWorker)
        running.board.set_condition("disk_low", low)
        running.board.note(disk=DiskStatus(free_bytes=5, images_bytes=7))
        clock.advance(100.0)
        conditions.step()
        housekeeping.step()
        housekeeping.store()
        since += [reason.since for reason in running.board.snapshot().reasons if reason.code == "disk_low"]
        assert running.archive.housekeeping.find(running.settings.name, step="hour")[0].disk_free_bytes == 5
        running.archive.close()
    assert since[0] == since[1] == clock.now() - timedelta(seconds=200.0)
