"""Cameras that lock, refuse or garble what they offer, as their users report it."""

from __future__ import annotations

import logging
from datetime import UTC, datetime
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sunarc.common.errors import CameraError, CameraLostError
from sunarc.imager.cameras.aravis import AravisCamera
from sunarc.imager.cameras.options import AravisOptions
from sunarc.imager.cameras.packed import pack
from sunarc.imager.checks import check_frames as frames_of_trial
from sunarc.imager.runtime.clock import VirtualClock

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)


def opened(camera: Any, **options: Any) -> AravisCamera:  # noqa: ANN401 - a stub of an untyped library
    result = AravisCamera(AravisOptions(address="127.0.0.9", **options), VirtualClock(NOON), library=camera.library())
    result.connect()
    return result


def is_triggered(features: dict[str, Any]) -> bool:
    return bool(features["TriggerMode"] == "On")


def test_a_frame_rate_switch_that_is_locked_while_triggers_are_on_does_not_prevent_the_second_opening(
    stub: SimpleNamespace,
) -> None:
    camera = stub.Camera(AcquisitionFrameRateEnable=True)
    camera.locked["AcquisitionFrameRateEnable"] = is_triggered
    opened(camera).close()  # the camera was left with triggers on, as after a kill
    assert camera.features["TriggerMode"] == "On"
    camera.features["AcquisitionFrameRateEnable"] = True
    opened(camera)
    assert camera.features["AcquisitionFrameRateEnable"] is False
    names = [call[0] for call in camera.calls]
    assert names.index("stop_acquisition") < names.index("clear_triggers") < names.index("set_boolean")


def test_acquisition_that_cannot_be_stopped_does_not_prevent_the_opening(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    camera.fails |= {name: stub.GLibError("nothing to stop", 1) for name in ("stop_acquisition", "clear_triggers")}
    assert opened(camera).info.serial == "77"


def test_a_feature_that_has_its_value_is_not_written(stub: SimpleNamespace) -> None:
    camera = stub.Camera(ExposureAuto="Off", GainAuto="Off", GammaEnable=False, Gain=0.0, ReverseX=False)
    for name in camera.features:
        camera.locked[name] = lambda _: True
    camera.locked.pop("ExposureTime")
    opened(camera)
    written = {call[1] for call in camera.calls if str(call[0]).startswith("set_") and len(call) == 3}
    assert written == {"ExposureTime"}


@pytest.mark.parametrize(
    ("name", "value", "other"),
    [("GainSelector", "AnalogAll", "All"), ("AcquisitionFrameRateEnable", True, False), ("ReverseX", True, False)],
)
def test_an_optional_feature_that_refuses_is_kept_and_compared(
    stub: SimpleNamespace, caplog: pytest.LogCaptureFixture, name: str, value: object, other: object
) -> None:
    camera = stub.Camera(**{name: value})
    camera.locked[name] = lambda _: True
    with caplog.at_level(logging.WARNING):
        ours = opened(camera)
    assert f"the camera refuses {name} = {other} and keeps {value}" in caplog.text
    ours.check()
    camera.features[name] = other
    with pytest.raises(CameraLostError, match=f"{name}.*{other}.*{value}"):
        ours.check()


def test_an_exposure_automatic_that_refuses_to_be_switched_off_is_refused(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    camera.locked["ExposureAuto"] = lambda _: True
    with pytest.raises(CameraError, match="ExposureAuto"):
        opened(camera)


@pytest.mark.parametrize(
    ("name", "value", "neutral"),
    [
        ("ReverseX", True, False),
        ("ReverseY", True, False),
        ("LUTEnable", True, False),
        ("TestPattern", "GreyHorizontalRamp", "Off"),
        ("TestImageSelector", "Testimage1", "Off"),
        ("DigitalShift", 2, 0),
        ("SharpeningEnable", True, False),
    ],
)
def test_what_changes_the_image_is_switched_off_and_compared(
    stub: SimpleNamespace, name: str, value: object, neutral: object
) -> None:
    camera = stub.Camera(**{name: value})
    ours = opened(camera)
    assert camera.features[name] == neutral
    ours.check()
    camera.features[name] = value
    with pytest.raises(CameraLostError, match=f"{name}.*{value}.*{neutral}"):
        ours.check()


def test_a_sharpness_whose_neutral_value_is_not_known_is_kept_and_compared(stub: SimpleNamespace) -> None:
    camera = stub.Camera(Sharpness=3)
    ours = opened(camera)
    assert camera.features["Sharpness"] == 3
    camera.features["Sharpness"] = 9
    with pytest.raises(CameraLostError, match=r"Sharpness.*9.*3"):
        ours.check()


def test_a_temperature_that_cannot_be_read_is_none_and_ends_no_cycle(stub: SimpleNamespace) -> None:
    camera = stub.Camera()
    ours = opened(camera)
    assert ours.check().temperature_c == 41.5
    camera.unreadable.add("DeviceTemperature")
    assert ours.check().temperature_c is None


def test_chunks_that_cannot_be_parsed_are_replaced_by_the_register_and_said_once(
    stub: SimpleNamespace, caplog: pytest.LogCaptureFixture
) -> None:
    camera = stub.Camera()
    camera.chunks, camera.noted_us = True, stub.GLibError("chunk not found", 2)
    camera.stream.answers.extend([stub.Buffer(frame_id=number) for number in (1, 2, 3)])
    ours = opened(camera)
    with caplog.at_level(logging.WARNING):
        assert [ours.expose(100.0).exposure_us for _ in range(2)] == [100.0, 100.0]
    assert caplog.text.count("cannot be parsed") == 1
    camera.software_trigger = lambda: camera.features.update(ExposureTime=700.0)  # another program sets it meanwhile
    with pytest.raises(CameraError, match=r"\b700\b.*\b100\b"):
        ours.expose(100.0)


@pytest.mark.parametrize("pixel_format", ["Mono12Packed"])
def test_a_packed_frame_is_decoded(stub: SimpleNamespace, pixel_format: str) -> None:
    camera = stub.Camera()
    counts = np.arange(24, dtype=np.uint16) * 170
    camera.stream.answers.extend(
        [stub.Buffer(frame_id=1, data=pack(counts, "12Packed")), stub.Buffer(frame_id=2, data=b"\0" * 35)]
    )
    ours = opened(camera, pixel_format=pixel_format)
    frame = ours.expose(100.0)
    assert frame.image.ravel().tolist() == counts.tolist()
    assert (frame.full_scale, frame.image.flags.writeable) == (4095, False)
    with pytest.raises(CameraError, match=r"\b35\b.*\b36\b.*Mono12Packed"):
        ours.expose(100.0)


def test_a_camera_whose_packets_never_arrive_is_told_from_one_that_loses_some(stub: SimpleNamespace) -> None:
    silent = stub.Camera()
    _, outcome, text = frames_of_trial(opened(silent), (100.0,))
    assert outcome == "fail"
    assert text.startswith("0 of 12 frames complete; the camera answers commands, but no packet of a frame arrives: ")
    lossy = stub.Camera()
    lossy.stream.answers.extend([stub.Buffer(status=stub.BufferStatus.MISSING_PACKETS) for _ in range(30)])
    _, outcome, text = frames_of_trial(opened(lossy), (100.0,))
    assert outcome == "fail"
    assert "firewall" not in text
    assert "net.core.rmem_max" in text
