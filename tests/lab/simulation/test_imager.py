"""What the registers of the simulated imager do to its frames, without a wire: the registers are a dictionary."""

from __future__ import annotations

import threading
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from tests.fixtures.calibration import small_camera

from sunarc.common.errors import OutsideError
from sunarc.imager.cameras.packed import unpack
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.lab.simulation import fake_camera as genicam
from sunarc.lab.simulation.fake_camera import FakeCamera, Request
from sunarc.lab.simulation.imager import DARK_US, MAX_IMAGES, ImagerOptions, _Imager, write_truth
from sunarc.lab.simulation.scene import Scene

START = datetime(2013, 5, 13, 17, tzinfo=UTC)
START_NS = round(START.timestamp()) * 10**9
REGION = (2, 1, 4, 3)


class Registers:
    """The register memory of a camera, and its share of lost packets."""

    def __init__(self) -> None:
        self.values: dict[int, int] = {}
        self.texts: dict[int, str] = {}
        self.lost = 0.0

    def read(self, address: int) -> int:
        return self.values.get(address, 0)

    def write(self, address: int, value: int) -> None:
        self.values[address] = value

    def write_text(self, address: int, text: str, *, length: int) -> None:
        self.texts[address] = text[:length]

    def lose_packets(self, share: float) -> None:
        self.lost = share

    def request(self) -> Request:
        exposure, gain, pixel_format = map(self.read, (genicam.EXPOSURE, genicam.GAIN, genicam.PIXEL_FORMAT))
        return Request(exposure, gain, pixel_format, REGION)


class CountingScene:
    """A scene whose counts tell which frame and which pixel they are; it remembers what it was asked for."""

    def __init__(self) -> None:
        self.camera = small_camera()
        self.asked: list[dict[str, Any]] = []
        self.sun = (float("nan"), float("nan"))

    def sun_pixel(self, _unix_s: float) -> np.ndarray[Any, Any]:
        return np.array(self.sun)

    def render(self, start_us: int, **how: Any) -> np.ndarray[Any, Any]:  # noqa: ANN401 - whatever is asked for
        self.asked.append({"start_us": start_us, **how})
        x, y, width, height = how["region"]
        counts = 100 * len(self.asked) + np.arange(x, x + width) + 10 * np.arange(y, y + height)[:, None]
        image: np.ndarray[Any, Any] = counts.astype(np.uint8 if how["full_scale"] == 255 else np.uint16)
        return image


class Bench:
    """An imager over a dictionary of registers and a virtual clock."""

    def __init__(self, **options: Any) -> None:  # noqa: ANN401 - of an imager
        self.registers, self.scene, self.clock = Registers(), CountingScene(), VirtualClock(START)
        self.imager = _Imager(
            ImagerOptions(start=START, **options),
            cast("Scene", self.scene),
            cast("FakeCamera", self.registers),
            stop=threading.Event(),
            clock=self.clock,
        )

    def frame(self, exposure_us: int = 20, *, pixel_format: str = "Mono12") -> tuple[np.ndarray[Any, Any], int]:
        number = genicam.PIXEL_FORMATS[pixel_format]
        return self.imager.fill(Request(exposure_us, 0, number, REGION))

    def exposures(self, *asked: int) -> list[float]:
        for exposure_us in asked:
            self.frame(exposure_us)
        return [one["exposure_us"] for one in self.scene.asked[-len(asked) :]]

    def wait(self, seconds: float) -> None:
        self.clock.wait(threading.Event(), seconds)


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_frame_is_rendered_as_it_was_asked_for(bench: Bench) -> None:
    bench.imager.fill(Request(37, 65, genicam.PIXEL_FORMATS["BayerRG8"], REGION))
    (asked,) = bench.scene.asked
    assert asked == {
        "start_us": START_NS // 1000, "exposure_us": 37.0, "gain_db": 6.5, "full_scale": 255, "bayer": "RGGB",
        "region": REGION,
    }  # fmt: skip


@pytest.mark.parametrize(("pixel_format", "dtype"), [("Mono8", np.uint8), ("Mono12", np.uint16), ("Mono16", np.uint16)])
def test_unpacked_frames_are_the_counts_themselves(bench: Bench, pixel_format: str, dtype: type) -> None:
    data, _ = bench.frame(pixel_format=pixel_format)
    expected = 100 + np.arange(2, 6) + 10 * np.arange(1, 4)[:, None]
    np.testing.assert_array_equal(data.view(dtype).reshape(3, 4), expected)


@pytest.mark.parametrize("pixel_format", ["Mono10p", "Mono12p", "Mono10Packed", "Mono12Packed"])
def test_packed_frames_unpack_to_the_counts(bench: Bench, pixel_format: str) -> None:
    data, _ = bench.frame(pixel_format=pixel_format)
    counts = unpack(data.tobytes(), pixel_format.removeprefix("Mono"), 12)
    np.testing.assert_array_equal(counts.reshape(3, 4), 100 + np.arange(2, 6) + 10 * np.arange(1, 4)[:, None])


def test_the_first_frame_has_the_time_of_the_start_however_late_it_is_asked_for(bench: Bench) -> None:
    bench.wait(5.0)
    assert bench.frame()[1] == START_NS


def test_time_passes_at_the_speed_of_the_options() -> None:
    bench = Bench(speed=60.0)
    bench.frame()
    bench.wait(2.0)
    assert bench.frame()[1] - START_NS == pytest.approx(120e9, abs=1e3)


def test_the_speed_register_changes_the_speed_without_a_step(bench: Bench) -> None:
    bench.frame()
    bench.wait(2.0)
    bench.registers.write(genicam.SPEED, 10_000)
    assert bench.frame()[1] - START_NS == pytest.approx(2e9, abs=1e3)
    bench.wait(3.0)
    assert bench.frame()[1] - START_NS == pytest.approx(32e9, abs=1e3)


def test_the_clock_offset_is_in_milliseconds_and_the_scene_keeps_the_true_time(bench: Bench) -> None:
    bench.registers.write(genicam.CLOCK_OFFSET, 37_000)
    assert bench.frame()[1] - START_NS == 37 * 10**9
    assert bench.scene.asked[0]["start_us"] == START_NS // 1000


def test_the_clock_drift_is_in_millionths_of_the_simulated_time() -> None:
    bench = Bench(speed=10.0)
    bench.registers.write(genicam.CLOCK_DRIFT, 50)
    bench.frame()
    bench.wait(100.0)
    _, timestamp_ns = bench.frame()
    assert timestamp_ns - 1000 * bench.scene.asked[1]["start_us"] == pytest.approx(50e-6 * 1000.0 * 1e9, abs=1e3)


def test_a_wrong_exposure_is_that_of_one_frame(bench: Bench) -> None:
    bench.registers.write(genicam.WRONG_EXPOSURE, 400)
    assert bench.exposures(20, 20) == [80.0, 20.0]


def test_all_exposures_are_wrong_until_they_are_set_right(bench: Bench) -> None:
    bench.registers.write(genicam.ALL_EXPOSURES, 50)
    assert bench.exposures(20, 40) == [10.0, 20.0]
    bench.registers.write(genicam.ALL_EXPOSURES, 0)
    assert bench.exposures(20) == [20.0]


def test_a_stale_exposure_is_that_of_the_frame_before(bench: Bench) -> None:
    bench.registers.write(genicam.STALE_EXPOSURE, 1)
    assert bench.exposures(10, 20, 40) == [10.0, 10.0, 20.0]


def test_a_black_frame_is_exposed_to_no_light(bench: Bench) -> None:
    bench.registers.write(genicam.BLACK, 1)
    assert bench.exposures(20) == [DARK_US]


def test_a_repeated_frame_is_the_last_of_the_same_request_with_a_new_time(bench: Bench) -> None:
    first, _ = bench.frame(20)
    bench.frame(40)
    bench.registers.write(genicam.REPEAT_FRAME, 1)
    bench.wait(1.0)
    again, timestamp_ns = bench.frame(20)
    np.testing.assert_array_equal(again, first)
    assert timestamp_ns > START_NS


def test_what_was_not_sent_before_cannot_be_repeated(bench: Bench) -> None:
    bench.registers.write(genicam.REPEAT_FRAME, 1)
    bench.frame(20)
    assert len(bench.scene.asked) == 1


def test_the_images_of_the_oldest_requests_are_forgotten(bench: Bench) -> None:
    bench.exposures(*range(10, 10 + MAX_IMAGES + 1))
    bench.registers.write(genicam.REPEAT_FRAME, 1)
    before = len(bench.scene.asked)
    bench.frame(11)
    assert len(bench.scene.asked) == before
    bench.frame(10)
    assert len(bench.scene.asked) == before + 1


def test_the_first_frames_after_a_start_are_bad_in_turn_and_the_next_are_not(bench: Bench) -> None:
    bench.registers.write(genicam.BAD_AFTER_START, 2)
    bench.registers.write(genicam.ACQUISITION, 1)
    assert np.all(bench.frame(20)[0].view(np.uint16).reshape(3, 4)[1:] == 0)
    assert bench.exposures(40, 60) == [20.0, 60.0]
    bench.registers.write(genicam.ACQUISITION, 1)
    assert bench.exposures(80, 20, 40) == [DARK_US, 20.0, 40.0]
    assert np.all(bench.frame(40)[0] > 0)


def test_foreign_packets_are_those_of_the_frame_before(bench: Bench) -> None:
    bench.registers.write(genicam.PACKET_SIZE, 36 + 4)
    before = bench.frame(20)[0]
    bench.scene.sun = (4.0, 2.0)
    bench.registers.write(genicam.FOREIGN_PACKETS, 2)
    sent = bench.frame(40)[0]
    from_before = np.flatnonzero(sent.view(np.uint16) == before.view(np.uint16))
    assert from_before.tolist() == [6, 7, 8, 9]  # the sun's pixel is the third of the second row


def test_binned_pixels_are_the_mean_of_those_that_they_join(bench: Bench) -> None:
    bench.registers.write(genicam.BINNING_X, 2)
    bench.registers.write(genicam.BINNING_Y, 3)
    data, _ = bench.frame()
    assert bench.scene.asked[0]["region"] == (4, 3, 8, 9)
    whole = 100 + np.arange(4, 12) + 10 * np.arange(3, 12)[:, None]
    means = [[whole[r : r + 3, c : c + 2].mean() for c in range(0, 8, 2)] for r in range(0, 9, 3)]
    np.testing.assert_array_equal(data.view(np.uint16).reshape(3, 4), np.floor(means))


@pytest.mark.parametrize(
    ("register", "value", "again"), [(genicam.DELAY, 250, 0.25), (genicam.FREEZE, 250, 0.0)], ids=["delay", "freeze"]
)
def test_a_frame_is_held_back_every_time_or_once(bench: Bench, register: int, value: int, again: float) -> None:
    bench.registers.write(register, value)
    for expected in (0.25, again):
        before = bench.clock.monotonic()
        bench.frame()
        assert bench.clock.monotonic() - before == pytest.approx(expected)


@pytest.mark.parametrize(("real", "expected"), [(True, 0.5), (False, 0.0)])
def test_an_exposure_takes_its_time_only_where_it_is_asked_to(*, real: bool, expected: float) -> None:
    bench = Bench(real_exposures=real)
    before = bench.clock.monotonic()
    bench.frame(500_000)
    assert bench.clock.monotonic() - before == pytest.approx(expected)


def test_a_real_exposure_is_sent_once_when_it_is_over_and_dated_at_its_trigger() -> None:
    bench = Bench(real_exposures=True)
    registers = {
        genicam.ACQUISITION: 1,
        genicam.EXPOSURE: 5_000_000,
        genicam.PIXEL_FORMAT: genicam.PIXEL_FORMATS["Mono12"],
    }
    bench.registers.values.update(registers)
    bench.frame()  # its clock starts
    bench.wait(7.0)
    bench.registers.write(genicam.EXPOSE, 1)
    bench.imager.expose()
    assert bench.registers.read(genicam.EXPOSE) == 0
    assert bench.clock.monotonic() == pytest.approx(7.0, abs=1e-3)
    bench.wait(4.99)
    bench.registers.write(genicam.EXPOSE, 1)  # during an exposure it is ignored
    bench.imager.expose()
    assert bench.registers.read(genicam.TRIGGER_SOFTWARE) == 0
    bench.wait(0.02)
    bench.imager.expose()
    assert bench.registers.read(genicam.TRIGGER_SOFTWARE) == 1
    bench.registers.write(genicam.TRIGGER_SOFTWARE, 0)  # the library takes note, and asks for the frame
    bench.imager.expose()
    assert bench.registers.read(genicam.TRIGGER_SOFTWARE) == 0
    before = bench.clock.monotonic()
    assert bench.frame()[1] == pytest.approx(START_NS + 7 * 10**9, abs=1e6)
    assert bench.clock.monotonic() == before
    bench.imager.expose()
    assert bench.registers.read(genicam.TRIGGER_SOFTWARE) == 0


def test_a_real_exposure_that_acquisition_does_not_outlast_is_never_sent() -> None:
    bench = Bench(real_exposures=True)
    bench.registers.values.update({genicam.ACQUISITION: 1, genicam.EXPOSURE: 1000, genicam.EXPOSE: 1})
    bench.registers.write(genicam.PIXEL_FORMAT, genicam.PIXEL_FORMATS["Mono12"])
    bench.imager.expose()
    bench.registers.write(genicam.ACQUISITION, 0)
    bench.imager.expose()
    bench.registers.write(genicam.ACQUISITION, 1)
    bench.wait(1.0)
    bench.imager.expose()
    assert bench.registers.read(genicam.TRIGGER_SOFTWARE) == 0


def test_lost_packets_are_in_thousandths(bench: Bench) -> None:
    bench.registers.write(genicam.LOSS, 25)
    bench.frame()
    assert bench.registers.lost == pytest.approx(0.025)


def test_after_a_power_cycle_it_is_automatic_free_running_and_nobodys(bench: Bench) -> None:
    for register in (genicam.POWER_CYCLE, genicam.CONTROL_PRIVILEGE, genicam.TRIGGER_MODE, genicam.ACQUISITION):
        bench.registers.write(register, 1)
    bench.registers.write(genicam.WIDTH, 10)
    bench.imager.obey()
    assert [bench.registers.read(r) for r in (genicam.POWER_CYCLE, genicam.CONTROL_PRIVILEGE)] == [0, 0]
    assert [bench.registers.read(r) for r in (genicam.TRIGGER_MODE, genicam.ACQUISITION)] == [0, 0]
    assert [bench.registers.read(r) for r in (genicam.EXPOSURE_AUTO, genicam.GAIN_AUTO)] == [1, 1]
    assert bench.registers.read(genicam.WIDTH) == bench.scene.camera.width


def test_dropped_control_changes_nothing_else(bench: Bench) -> None:
    bench.registers.write(genicam.CONTROL_PRIVILEGE, 2)
    before = dict(bench.registers.values)
    bench.registers.write(genicam.DROP_CONTROL, 1)
    bench.imager.obey()
    assert bench.registers.values == before | {genicam.DROP_CONTROL: 0, genicam.CONTROL_PRIVILEGE: 0}


def test_the_registers_begin_with_the_sensor_of_the_scene(bench: Bench) -> None:
    read: Callable[[int], int] = bench.registers.read
    assert (read(genicam.SENSOR_WIDTH), read(genicam.SENSOR_HEIGHT)) == (640, 480)
    assert (read(genicam.WIDTH), read(genicam.HEIGHT)) == (640, 480)
    assert read(genicam.TEMPERATURE) == 215
    assert bench.registers.texts == {genicam.VENDOR: "sunarc", genicam.MODEL: "simulated sky"}


def test_a_truth_that_cannot_be_written_is_an_outside_fault(tmp_path: Path) -> None:
    scene = SimpleNamespace(camera=small_camera(), site=ImagerOptions().site)
    with pytest.raises(OutsideError):
        write_truth(tmp_path / "absent" / "truth.json", cast("Scene", scene), name="x", created_at=START)
