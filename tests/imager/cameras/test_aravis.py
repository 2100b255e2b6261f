"""What the adapter makes of everything that a camera can do wrong (a real connection: tests/lab/simulation)."""

from __future__ import annotations

import gc
import sys
import weakref
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sunarc.common.errors import (
    CameraError,
    CameraLostError,
    CameraSilentError,
    CameraTimeoutError,
    ConfigurationError,
    InputError,
)
from sunarc.imager.cameras import aravis as adapter
from sunarc.imager.cameras.aravis import AravisCamera, follows, open_aravis
from sunarc.imager.cameras.options import AravisOptions
from sunarc.imager.runtime.clock import VirtualClock

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)


def opened(camera: Any, **options: Any) -> AravisCamera:  # noqa: ANN401 - a stub of an untyped library
    settings = AravisOptions(address="127.0.0.9", **options)
    result = AravisCamera(settings, VirtualClock(NOON), library=camera.library())
    result.connect()
    return result


def answering(camera: Any, *answers: Any, **options: Any) -> AravisCamera:  # noqa: ANN401 - as above
    camera.stream.answers.extend(answers)
    return opened(camera, **options)


def test_settings_are_pinned_before_the_stream_is_made(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    opened(camera, gain_db=50.0, packet_size=8000, packet_socket=False)
    names = [call[0] for call in camera.calls]
    assert ("set_string", "ExposureAuto", "Off") in camera.calls
    assert ("set_string", "GainAuto", "Off") in camera.calls
    assert ("set_boolean", "GammaEnable", False) in camera.calls
    assert ("set_float", "Gain", 24.0) in camera.calls
    assert ("gv_set_stream_options", "udp") in camera.calls
    assert names.index("set_region") < names.index("gv_set_packet_size") < names.index("get_payload")
    assert names.index("get_payload") < names.index("create_stream") < names.index("start_acquisition")


def test_a_frame_says_what_the_camera_said(stub: SimpleNamespace) -> None:
    camera = answering(stub.Camera(), stub.Buffer(frame_id=7), gain_db=3.0)
    frame = camera.expose(123.4)
    assert frame.exposure_us == 123.0
    assert (frame.gain_db, frame.pixel_format, frame.full_scale, frame.frame_id) == (3.0, "Mono12", 4095, 7)
    assert frame.time == NOON + timedelta(microseconds=61.5)
    assert np.array_equal(frame.image.ravel(), np.frombuffer(bytes(range(48)), "<u2"))
    assert camera.info.model == ""
    assert camera.info.serial == "77"


def test_first_frames_that_nobody_wants_are_taken_at_the_shortest_exposure(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    ours = answering(camera, stub.Buffer(frame_id=2))
    names = [call[0] for call in camera.calls]
    assert names[names.index("start_acquisition") :].count("software_trigger") == 3
    assert camera.features["ExposureTime"] == 10.0
    assert ours.expose(500.0).frame_id == 2


def test_where_the_first_frame_does_not_come_it_is_waited_for_before_the_next(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    camera.stream.first = type(camera.stream.answers)([None])
    camera.stream.answers.extend([stub.Buffer(frame_id=1), stub.Buffer(frame_id=2)])
    ours = opened(camera)
    assert ours.expose(10.0).frame_id == 2
    assert "stop_acquisition" in [call[0] for call in camera.calls]


def test_a_disciplined_camera_s_own_time_is_the_start_of_the_exposure(stub: SimpleNamespace) -> None:
    frame = answering(stub.Camera(), stub.Buffer(), timestamps="camera").expose(1000.0)
    assert frame.time == datetime(2013, 5, 13, 18, 30, 0, 123_956, tzinfo=UTC)


@pytest.mark.parametrize(
    ("given", "seconds"),
    [
        ({"timestamp_scale": "tai"}, -37.0),
        ({"timestamp_offset_s": 0.25}, 0.25),
        ({"timestamp_scale": "tai", "timestamp_offset_s": -1.0}, -38.0),
    ],
)
def test_a_camera_s_time_is_converted_to_utc(stub: SimpleNamespace, given: dict[str, Any], seconds: float) -> None:
    plain = answering(stub.Camera(), stub.Buffer(), timestamps="camera").expose(1000.0)
    frame = answering(stub.Camera(), stub.Buffer(), timestamps="camera", **given).expose(1000.0)
    assert (frame.time - plain.time).total_seconds() == pytest.approx(seconds)


def test_a_camera_s_time_is_compared_with_the_host_s_at_every_frame(stub: SimpleNamespace) -> None:
    frame = answering(stub.Camera(), stub.Buffer(), timestamps="camera").expose(1000.0)
    assert frame.host_offset_s == pytest.approx(0.123456)  # the host says that it is NOON
    assert answering(stub.Camera(), stub.Buffer(), timestamps="host").expose(1000.0).host_offset_s is None


@pytest.mark.parametrize(("asked", "got"), [(1.0, 10.0), (5e6, 1e6)])
def test_an_exposure_beyond_the_camera_s_bounds_is_the_nearest_it_can(
    stub: SimpleNamespace, asked: float, got: float
) -> None:
    assert answering(stub.Camera(), stub.Buffer()).expose(asked).exposure_us == got


def test_the_wait_is_the_exposure_and_a_second(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    camera.stream.answers.append(stub.Buffer())
    opened(camera).expose(48_000.0)
    assert camera.stream.waits_us == [1_048_000]


@pytest.mark.parametrize(
    ("buffer", "error", "words"),
    [
        (None, CameraSilentError, "no frame came"),
        ({"status": "TIMEOUT"}, CameraTimeoutError, "packets of the frame were lost"),
        ({"status": "MISSING_PACKETS"}, CameraTimeoutError, "packets of the frame were lost"),
        ({"status": "ABORTED"}, CameraError, "not usable"),
        ({"size": (6, 2)}, CameraError, "6×2"),
        ({"data": b"\0" * 47}, CameraError, "47 bytes"),
    ],
)
def test_a_frame_in_doubt_is_refused_and_its_buffer_given_back(
    stub: SimpleNamespace, buffer: dict[str, Any] | None, error: type[CameraError], words: str
) -> None:
    camera = stub.Camera()
    given = None
    if buffer is not None:
        status = stub.BufferStatus[buffer.pop("status", "SUCCESS")]
        given = stub.Buffer(status=status, **buffer)
    camera.stream.answers.append(given)
    ours = opened(camera)
    before = camera.stream.pushed
    with pytest.raises(error, match=words) as caught:
        ours.expose(10.0)
    assert type(caught.value) is error
    assert camera.stream.pushed - before == (given is not None)


def test_a_frame_out_of_turn_is_refused(stub: SimpleNamespace) -> None:
    camera = answering(stub.Camera(), stub.Buffer(frame_id=3), stub.Buffer(frame_id=5))
    camera.expose(10.0)
    with pytest.raises(CameraError, match=r"5.*3"):
        camera.expose(10.0)


def test_after_a_doubt_the_camera_is_stopped_emptied_and_started(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    camera.stream.answers.extend([None, stub.Buffer(frame_id=1), stub.Buffer(frame_id=9)])
    ours = opened(camera)
    with pytest.raises(CameraTimeoutError):
        ours.expose(10.0)
    camera.calls.clear()
    assert ours.expose(10.0).frame_id == 9  # the late frame 1 was waited for and thrown away
    names = [call[0] for call in camera.calls]
    assert names[:2] == ["stop_acquisition", "start_acquisition"]


def test_frames_that_nobody_waits_for_are_thrown_away_before_the_trigger(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    camera.stream.answers.append(stub.Buffer(frame_id=2))
    ours = opened(camera)
    camera.stream.late.append(stub.Buffer(frame_id=1))
    assert ours.expose(10.0).frame_id == 2
    assert not camera.stream.late


@pytest.mark.parametrize("code", [2, 5, 10])
def test_a_command_that_stays_unanswered_means_that_the_camera_is_lost(stub: SimpleNamespace, code: int) -> None:
    camera = stub.Camera()
    ours = opened(camera)
    camera.fails["set_float"] = stub.GLibError("ack timeout", code)
    with pytest.raises(CameraLostError, match="ack timeout"):
        ours.expose(10.0)


def test_another_fault_of_a_command_is_an_error_of_that_exposure(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    ours = opened(camera)
    camera.fails["software_trigger"] = stub.GLibError("nosuchfeature", 1)
    with pytest.raises(CameraError, match="nosuchfeature") as caught:
        ours.expose(10.0)
    assert type(caught.value) is CameraError


def test_control_that_was_lost_is_told_at_the_next_exposure_and_nothing_is_sent(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    ours = opened(camera)
    camera.device.handlers[1](camera.device)
    camera.calls.clear()
    with pytest.raises(CameraLostError):
        ours.expose(10.0)
    ours.close()
    assert camera.calls == []


def test_the_signal_s_handler_does_not_hold_the_camera(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    ours = opened(camera)
    handler, reference = camera.device.handlers[1], weakref.ref(ours)
    del ours
    gc.collect()
    assert reference() is None
    handler()


def test_closing_stops_disconnects_and_lets_go_and_may_be_done_twice(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    ours = opened(camera)
    camera.calls.clear()
    ours.close()
    ours.close()
    assert [call[0] for call in camera.calls].count("stop_acquisition") == 1
    assert camera.device.handlers == {}
    assert ours._camera is ours._device is ours._stream is None
    with pytest.raises(CameraLostError, match="not open"):
        ours.expose(10.0)


@pytest.mark.parametrize("step", ["set_region", "get_payload", "create_stream", "start_acquisition"])
def test_an_opening_that_fails_half_way_lets_go(
    stub: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    camera = stub.Camera()
    camera.fails[step] = stub.GLibError("refused", 1)
    monkeypatch.setattr(adapter, "_import_aravis", camera.library)
    with pytest.raises(CameraError, match="refused") as caught:
        open_aravis(AravisOptions(address="127.0.0.9"), VirtualClock(NOON))
    assert camera.device.handlers == {}
    assert caught.value.__context__ is None


def test_a_format_that_the_camera_lacks_is_refused_with_those_it_has(stub: SimpleNamespace) -> None:
    with pytest.raises(InputError) as refused:
        opened(stub.Camera(), pixel_format="Mono16")
    assert refused.value.field == "camera.pixel_format"
    offered = ("Mono8", "Mono12", "Mono12Packed", "BayerRG8")
    assert all(name in refused.value.remedy for name in offered)


def test_a_region_beyond_the_sensor_is_refused(stub: SimpleNamespace) -> None:
    with pytest.raises(InputError, check=lambda error: error.field == "camera.region"):
        opened(stub.Camera(), region=(0, 0, 7, 4))


def test_a_machine_without_gi_is_told_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gi", None)
    with pytest.raises(ConfigurationError, match=r"gir1\.2-aravis-0\.8"):
        open_aravis(AravisOptions(address="127.0.0.9"), VirtualClock(NOON))


def test_frame_counts_wrap_as_gige_vision_does() -> None:
    assert follows(1, 2)
    assert follows(65_535, 1)
    assert follows(65_535, 65_536)
    assert not follows(65_535, 0)
    assert not follows(4, 4)
    assert not follows(4, 6)


def test_the_exposure_that_a_frame_notes_of_itself_has_to_agree(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    camera.chunks, camera.noted_us = True, 3000.0
    ours = answering(camera, stub.Buffer(frame_id=1), stub.Buffer(frame_id=2))
    assert ours.expose(3000.0).exposure_us == 3000.0
    with pytest.raises(CameraError, match=r"\b3000\b.*\b12000\b"):
        ours.expose(12_000.0)


def test_a_camera_that_was_set_by_another_is_lost_and_says_how(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    ours = opened(camera)
    assert ours.check().temperature_c == 41.5
    camera.features["GainAuto"] = "Continuous"
    with pytest.raises(CameraLostError, match=r"GainAuto.*Continuous.*Off"):
        ours.check()


@pytest.mark.parametrize(
    ("features", "bounds", "asked_us", "written", "had_us"),
    [
        ({"ExposureTimeAbs": 100.0}, (10.0, 1e6), 33.3, ("set_float", "ExposureTimeAbs", 33.3), 33.3),
        (
            {"ExposureTimeRaw": 7, "ExposureTimeBaseAbs": 20.0},
            (1, 50_000),
            3_008.0,
            ("set_integer", "ExposureTimeRaw", 150),
            3000.0,
        ),
    ],
)
def test_exposures_go_by_the_vendors_names_too(  # noqa: PLR0917 - parametrised
    stub: SimpleNamespace,
    features: dict[str, Any],
    bounds: tuple[float, float],
    asked_us: float,
    written: tuple[object, ...],
    had_us: float,
) -> None:
    camera = stub.Camera(**features)
    del camera.features["ExposureTime"]
    camera.bounds[written[1]] = bounds
    camera.stream.answers.append(stub.Buffer())
    assert opened(camera).expose(asked_us).exposure_us == had_us
    assert written in camera.calls


def test_gain_in_raw_steps_is_set_to_its_lowest_and_a_gamma_without_a_switch_to_one(stub: SimpleNamespace) -> None:
    camera = stub.Camera(GainRaw=36, Gamma=0.45, BlackLevelRaw=16)
    for name in ("Gain", "GammaEnable"):
        del camera.features[name]
    camera.bounds |= {"GainRaw": (4, 400), "BlackLevelRaw": (0, 64)}
    opened(camera, gain_db=6.0, black_level=8.0)
    assert (camera.features["GainRaw"], camera.features["Gamma"], camera.features["BlackLevelRaw"]) == (4, 1.0, 8)


def test_a_camera_that_cannot_bin_is_not_asked_to(stub: SimpleNamespace) -> None:
    with pytest.raises(ConfigurationError, match="cannot bin"):
        opened(stub.Camera(), binning=2)


def test_usb_goes_by_the_device_s_id_and_looks_for_nothing_on_the_network(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    aravis, glib = camera.library()
    switched_off: list[str] = []
    aravis.disable_interface = switched_off.append
    ours = AravisCamera(
        AravisOptions(address="Vendor-1234", transport="usb3"), VirtualClock(NOON), library=(aravis, glib)
    )
    ours.connect()
    assert set(switched_off) == {"GigEVision", "Fake"}


def test_the_gain_is_raised_restored_and_read_back(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    adapter_of = answering(camera, stub.Buffer(frame_id=7), stub.Buffer(frame_id=8), gain_db=3.0)
    assert adapter_of.info.gain_raise_db == 21.0
    adapter_of.raise_gain(12.0)
    frame = adapter_of.expose(123.0)
    assert (frame.gain_db, frame.raised_db) == (15.0, 12.0)
    adapter_of.check()
    adapter_of.restore_gain()
    frame = adapter_of.expose(123.0)
    assert (frame.gain_db, frame.raised_db) == (3.0, 0.0)
    adapter_of.check()


def test_a_gain_that_the_camera_does_not_take_back_is_an_error(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    adapter_of = opened(camera, gain_db=3.0)
    adapter_of.raise_gain(12.0)
    camera.set_float = lambda *_: None
    with pytest.raises(CameraError):
        adapter_of.restore_gain()
    with pytest.raises(CameraError):
        adapter_of.raise_gain(6.0)


def test_a_camera_with_a_raw_gain_alone_raises_none(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    camera.features["GainRaw"] = camera.features.pop("Gain")
    camera.bounds["GainRaw"] = (0.0, 24.0)
    assert opened(camera).info.gain_raise_db == 0.0


def test_where_no_frame_is_whole_with_large_packets_smaller_ones_are_used_and_said(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    camera.packet_size = 8000
    camera.stream.first = type(camera.stream.answers)(
        stub.Buffer(status=stub.BufferStatus.MISSING_PACKETS) for _ in range(3)
    )
    ours = answering(camera, stub.Buffer(frame_id=9))
    assert (ours.info.packet_bytes_lost, ours.info.packet_bytes, camera.packet_size) == (8000, 1500, 1500)
    assert ours.expose(3000.0).frame_id == 9


@pytest.mark.parametrize("whole", [0, 1])
def test_packets_stay_as_they_are_where_smaller_ones_would_not_help(stub: SimpleNamespace, whole: int) -> None:
    camera = stub.Camera()
    camera.packet_size = 8000
    camera.stream.loses = 3 - whole
    ours = opened(camera)
    assert (ours.info.packet_bytes_lost, camera.packet_size) == (None, 8000)


@pytest.mark.parametrize("refusal", ["raised", "kept"])
def test_a_frame_is_never_taken_with_an_exposure_that_the_camera_did_not_take(
    stub: SimpleNamespace, refusal: str
) -> None:
    camera = stub.Camera()
    ours = answering(camera, stub.Buffer(frame_id=4))
    assert ours.expose(3000.0).exposure_us == 3000.0
    write = camera.set_feature
    if refusal == "raised":
        camera.fails["set_float"] = stub.GLibError("busy", 17)
    else:
        camera.set_feature = lambda name, value: None if name == "ExposureTime" else write(name, value)
    for _ in range(2):
        with pytest.raises(CameraError):
            ours.expose(12_000.0)
    camera.fails.clear()
    camera.set_feature = write
    camera.stream.first.clear()
    camera.stream.answers.extend([None, stub.Buffer(frame_id=9)])
    assert ours.expose(12_000.0).exposure_us == 12_000.0
