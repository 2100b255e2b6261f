"""Frames that crossed a GigE Vision connection between two processes are the scene's own."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pytest
from tests.fixtures.archive import new_archive
from tests.fixtures.board import status_registry

from sunarc.common.errors import CameraError, CameraLostError, OutsideError
from sunarc.detection.values import DiscOptions
from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.cameras.aravis import AravisCamera, open_aravis
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.cameras.options import AravisOptions
from sunarc.imager.runtime.clock import SystemClock, VirtualClock
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.workers.detect import DetectWorker, FrozenFrames, SightingWriteBuffer
from sunarc.imager.workers.options import SensorOptions
from sunarc.imager.workers.sun_prediction import SunPredictor
from sunarc.lab.simulation.imager import ImagerOptions, run_imager
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP

from .conftest import require_aravis, wait_until

pytestmark = [pytest.mark.gige, pytest.mark.timeout(240)]

ADDRESS = "127.0.0.1"
REGION = (700, 500, 420, 300)
START = datetime(2013, 5, 13, 17, 0, tzinfo=UTC)
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


class Imager(Protocol):
    scene: Scene
    truth: Path

    def start(self) -> None: ...

    def kill(self) -> None: ...


@pytest.fixture
def opened() -> Iterator[Callable[..., AravisCamera]]:
    cameras: list[AravisCamera] = []

    def open_one(**options: Any) -> AravisCamera:  # noqa: ANN401 - options as they come
        settings = {"region": REGION, "timestamps": "camera", "packet_size": 60_000, "packet_socket": False}
        camera = open_aravis(AravisOptions(address=ADDRESS, **{**settings, **options}), SystemClock())
        cameras.append(camera)
        return camera

    yield open_one
    for camera in cameras:
        camera.close()


def start_us(frame: Frame) -> int:
    return (frame.time - EPOCH) // timedelta(microseconds=1) - round(frame.exposure_us / 2)


def rendered(scene: Scene, frame: Frame, region: tuple[int, int, int, int] | None = REGION) -> np.ndarray[Any, Any]:
    return scene.render(
        start_us(frame),
        exposure_us=frame.exposure_us,
        gain_db=frame.gain_db,
        full_scale=frame.full_scale,
        region=region,
    )


@pytest.mark.parametrize("pixel_format", ["Mono8", "Mono12", "Mono12Packed", "Mono12p", "Mono10Packed", "Mono10p"])
def test_every_pixel_of_a_full_frame_arrives(
    imager: Imager, opened: Callable[..., AravisCamera], pixel_format: str
) -> None:
    camera = opened(region=None, pixel_format=pixel_format)
    frame = exposed(camera, 3000.0)
    assert frame.image.shape == (1748, 1748)
    assert frame.image.dtype == (np.uint8 if pixel_format == "Mono8" else np.uint16)
    assert np.array_equal(frame.image, rendered(imager.scene, frame, None))
    assert not frame.image.flags.writeable


def test_each_frame_has_the_exposure_that_it_was_asked_for(imager: Imager, opened: Callable[..., AravisCamera]) -> None:
    camera = opened()
    choose = random.Random(7)
    for _ in range(25):
        exposure_us = choose.choice([10.0, 3000.0, 12_000.0, 48_000.0])
        frame = exposed(camera, exposure_us)
        assert frame.exposure_us == exposure_us
        assert np.array_equal(frame.image, rendered(imager.scene, frame))


def test_gain_region_and_identity_are_obeyed(imager: Imager, opened: Callable[..., AravisCamera]) -> None:
    camera = opened(gain_db=6.0)
    frame = exposed(camera, 3000.0)
    assert frame.gain_db == 6.0
    assert np.array_equal(frame.image, rendered(imager.scene, frame))
    assert (camera.info.vendor, camera.info.model, camera.info.serial) == ("sunarc", "simulated sky", "SIM-0001")
    assert (camera.info.width, camera.info.height) == REGION[2:]
    assert (camera.info.exposure_min_us, camera.info.exposure_step_us) == (1.0, 1.0)


def test_exposures_are_kept_within_the_camera_s_bounds(imager: Imager, opened: Callable[..., AravisCamera]) -> None:
    assert imager.truth.exists()
    assert exposed(opened(), 0.2).exposure_us == 1.0


def test_frames_carry_simulated_time_which_runs_faster(imager: Imager, opened: Callable[..., AravisCamera]) -> None:
    assert imager.truth.exists()
    camera, clock = opened(), SystemClock()
    first, began = exposed(camera, 10.0), clock.monotonic()
    clock.wait(threading.Event(), 1.0)
    second, ended = exposed(camera, 10.0), clock.monotonic()
    assert START <= first.time < START + timedelta(hours=3)
    assert (second.time - first.time).total_seconds() == pytest.approx(60.0 * (ended - began), rel=0.3)


def test_frames_dated_by_the_host_carry_its_time(imager: Imager, opened: Callable[..., AravisCamera]) -> None:
    assert imager.truth.exists()
    clock = SystemClock()
    before = clock.now()
    frame = exposed(opened(timestamps="host"), 48_000.0)
    assert before + timedelta(microseconds=24_000) <= frame.time <= clock.now() + timedelta(microseconds=24_000)


def test_the_truth_is_written_as_a_document(imager: Imager) -> None:
    document = json.loads(imager.truth.read_text())
    assert document["schema"] == "sunarc.calibration/2"
    assert document["pose"]["theta_zz_deg"] == pytest.approx(2.46)


def test_a_second_imager_is_told_that_the_port_is_taken(imager: Imager) -> None:
    assert imager.truth.exists()
    with pytest.raises(OutsideError, match=ADDRESS):
        run_imager(ImagerOptions(address=ADDRESS, die_with_parent=False), threading.Event())


def test_a_camera_held_by_another_is_said_to_be(imager: Imager, opened: Callable[..., AravisCamera]) -> None:
    assert imager.truth.exists()
    first = opened()
    with pytest.raises(CameraLostError, match=ADDRESS):
        opened()
    assert exposed(first, 10.0).exposure_us == 10.0


def test_failed_openings_leave_the_camera_free(imager: Imager, opened: Callable[..., AravisCamera]) -> None:
    assert imager.truth.exists()
    kept: list[Exception] = []
    for _ in range(3):
        with pytest.raises(Exception, match=r"camera\.region") as caught:
            opened(region=(1700, 0, 100, 100))
        kept.append(caught.value)
    assert exposed(opened(), 10.0).exposure_us == 10.0


def test_an_address_that_does_not_answer_is_said_within_seconds() -> None:
    clock = SystemClock()
    began = clock.monotonic()
    with pytest.raises(CameraLostError, match=r"127\.0\.0\.99"):
        open_aravis(AravisOptions(address="127.0.0.99"), clock)
    assert clock.monotonic() - began < 8.0


def test_a_camera_that_died_is_lost_and_can_be_opened_again(
    imager: Imager, opened: Callable[..., AravisCamera]
) -> None:
    camera = opened(answer_timeout_s=0.5)
    exposed(camera, 10.0)
    imager.kill()
    assert any(is_lost(camera) for _ in range(5))
    camera.close()
    imager.start()
    frame = exposed(opened(), 10.0)
    assert np.array_equal(frame.image, rendered(imager.scene, frame))


def test_a_frame_that_comes_late_is_never_taken_for_the_next(
    imager: Imager, opened: Callable[..., AravisCamera]
) -> None:
    camera = opened(answer_timeout_s=0.4)
    camera._camera.set_integer("SimFreezeMs", 600)
    with pytest.raises(CameraError):
        camera.expose(48_000.0)
    for exposure_us in (10.0, 3000.0, 10.0):
        frame = exposed(camera, exposure_us)
        assert frame.exposure_us == exposure_us
        assert np.array_equal(frame.image, rendered(imager.scene, frame))


def test_lost_packets_are_an_error_and_pass(imager: Imager, opened: Callable[..., AravisCamera]) -> None:
    camera = opened(packet_size=1400, answer_timeout_s=0.5)
    camera._camera.set_integer("SimLossPermille", 500)
    assert any(fails(camera) for _ in range(3))
    camera._camera.set_integer("SimLossPermille", 0)
    frame = exposed(camera, 10.0)
    assert np.array_equal(frame.image, rendered(imager.scene, frame))


def detect_worker(archive: Archive) -> DetectWorker:
    board, camera = status_registry(VirtualClock(START)), CameraArchive(archive, name="roof", site=SGP)
    return DetectWorker(
        DropOldestQueue(capacity=4),
        keeper=SightingWriteBuffer(archive, board=board),
        camera="roof",
        predictor=SunPredictor(camera),
        options=SensorOptions(black_level_fraction=32 / 4095),
        disc=DiscOptions(),
        clock_error_s=lambda _: 0.01,
        report=lambda *_: None,
        board=board,
        frozen=FrozenFrames(camera, board=board),
        cadence_s=30.0,
    )


def set_fault(camera: AravisCamera, name: str, value: int) -> None:
    camera._camera.set_integer(name, value)


def test_the_bad_first_frames_after_each_start_are_taken_for_nothing(
    imager: Imager, opened: Callable[..., AravisCamera]
) -> None:
    camera = opened()
    set_fault(camera, "SimBadAfterStart", 2)
    try:
        for _ in range(2):
            camera.distrust()
            for exposure_us in (3000.0, 12_000.0):
                frame = exposed(camera, exposure_us)
                assert np.array_equal(frame.image, rendered(imager.scene, frame))
        camera.close()
        camera = opened()
        frame = exposed(camera, 48_000.0)
        assert np.array_equal(frame.image, rendered(imager.scene, frame))
    finally:
        set_fault(camera, "SimBadAfterStart", 0)


@pytest.fixture
def narrow_network(tmp_path: Path) -> Iterator[list[str]]:
    """Run an imager that may send 9,000 bytes into a link of 1,500; yield what prefixes a command on that link."""
    require_aravis()
    there, here = (f"sunarc{os.getpid()}{end}" for end in "ab")
    made = subprocess.run(["ip", "netns", "add", there], capture_output=True, check=False)
    if made.returncode:
        pytest.skip("no network of its own can be made here (ip netns add needs CAP_NET_ADMIN)")
    commands = [
        f"netns add {here}", f"link add va netns {there} mtu 9000 type veth peer name vb netns {here}",
        f"-n {there} address add 192.0.2.1/24 dev va", f"-n {here} address add 192.0.2.2/24 dev vb",
        f"-n {there} link set va up", f"-n {here} link set vb up mtu 1500",
    ]  # fmt: skip
    inside = ["ip", "netns", "exec"]
    truth = tmp_path / "truth.json"
    script = str(Path(__file__).with_name("imager_process.py"))
    process = None
    try:
        for command in commands:
            subprocess.run(["ip", *command.split()], check=True)
        process = subprocess.Popen(
            [*inside, there, sys.executable, script, '{"address": "192.0.2.1"}', START.isoformat(), str(truth)]
        )
        wait_until(truth.exists, what="the simulated imager", at_most_s=90.0)
        yield [*inside, here]
    finally:
        if process is not None:
            process.terminate()
            process.wait(timeout=20)
        for name in (there, here):
            subprocess.run(["ip", "netns", "delete", name], check=False)


LARGE_AND_SMALL = """
from sunarc.imager.cameras.aravis import open_aravis
from sunarc.imager.cameras.options import AravisOptions
from sunarc.imager.runtime.clock import SystemClock
for size in (8000, 1400):
    options = AravisOptions(address="192.0.2.1", packet_size=size, region=(700, 500, 420, 300))
    camera = open_aravis(options, SystemClock())
    print(camera.info.packet_bytes_lost, camera.info.packet_bytes, camera.expose(3000.0).image.shape)
    camera.close()
"""


def test_packets_that_the_network_does_not_pass_are_replaced_by_smaller_ones(narrow_network: list[str]) -> None:
    command = [*narrow_network, sys.executable, "-c", LARGE_AND_SMALL]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.splitlines() == ["8000 1500 (300, 420)", "None None (300, 420)"]


def test_a_resend_with_another_frame_s_packets_gives_no_wrong_sighting(
    imager: Imager, opened: Callable[..., AravisCamera], tmp_path: Path
) -> None:
    first = opened()
    x, y = imager.scene.sun_pixel(exposed(first, 10.0).time.timestamp())
    first.close()
    region = (round(x) // 2 * 2 - 150, round(y) // 2 * 2 - 150, 300, 300)
    camera = opened(region=region, packet_size=1400)
    archive = new_archive(tmp_path, width=300, height=300)
    worker = detect_worker(archive)
    accepted = []
    for foreign in (0, 2, 0):
        set_fault(camera, "SimForeignPackets", foreign)
        found = [(frame := exposed(camera, (3.0, 12.0)[number % 2]), worker.process(frame)) for number in range(8)]
        accepted.append([(frame.time, one) for frame, one in found if one.accepted])
    assert [len(accepted[number]) for number in (0, 2)] == [8, 8]
    assert len(accepted[1]) < 8
    for point in archive.sightings.find("roof", accepted=True):
        sun = imager.scene.sun_pixel(point.time.timestamp()) - region[:2]
        assert np.hypot(point.x_px - sun[0], point.y_px - sun[1]) < 0.1
    archive.close()


def exposed(camera: AravisCamera, exposure_us: float, tries: int = 8) -> Frame:
    """Expose, and again after a loss: small socket buffers lose packets on a busy machine."""
    for _ in range(tries - 1):
        try:
            return camera.expose(exposure_us)
        except CameraLostError:
            raise
        except CameraError:
            continue
    return camera.expose(exposure_us)


def fails(camera: AravisCamera) -> bool:
    """Return whether an exposure fails."""
    try:
        camera.expose(10.0)
    except CameraError:
        return True
    return False


def is_lost(camera: AravisCamera) -> bool:
    """Return whether a dead camera is said to be lost; a timeout before that is allowed, a frame is not."""
    with pytest.raises(CameraError) as caught:
        camera.expose(10.0)
    return isinstance(caught.value, CameraLostError)
