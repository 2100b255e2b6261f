"""Checks of a camera: abilities, stream, exposures, and a few trial frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from typing import Literal, NamedTuple

from sunarc.app.cameras import camera_opener
from sunarc.cameras.aravis import AravisCamera
from sunarc.cameras.frame import SkyCamera
from sunarc.errors import CameraError, CameraSilentError, CameraTimeoutError, SunarcError
from sunarc.runtime.clock import Clock
from sunarc.settings.model import Settings

Outcome = Literal["ok", "warn", "fail"]
_TRIAL_FRAMES = 12
_SHORT_US = 100.0
_SILENT = (
    "the camera answers commands, but no packet of a frame arrives: let UDP from its address through this host's "
    "firewall, and see that its packets are not above the network's MTU and that it takes software triggers"
)


class CheckResult(NamedTuple):
    """Result of one check.

    Attributes
    ----------
    what : what was checked.
    outcome : "ok", "warn" (the service runs, with less) or "fail".
    text : what was found, with the remedy where one is needed.
    """

    what: str
    outcome: Outcome
    text: str


def survey(settings: Settings, *, clock: Clock) -> Iterator[CheckResult]:
    """Open the camera as the service would, and run the checks of it."""
    try:
        camera = camera_opener(settings, clock)()
    except SunarcError as error:
        yield CheckResult("camera", "fail", str(error))
        return
    with closing(camera):
        yield _identity(camera)
        if isinstance(camera, AravisCamera):
            yield from (CheckResult(what, "ok", text) for what, text in camera.abilities())
            yield from _stream(camera)
        yield _exposures(camera, settings.capture.hdr_exposures_us)
        yield _trial(camera, settings.capture.hdr_exposures_us)


def _identity(camera: SkyCamera) -> CheckResult:
    info = camera.info
    text = f"{info.vendor} {info.model} ({info.serial or 'no serial number'}) at {info.address}"
    return CheckResult("camera", "ok", f"{text}: {info.width}x{info.height} px in {info.pixel_format} will be used")


def _stream(camera: AravisCamera) -> Iterator[CheckResult]:
    if camera.link is not None:
        yield CheckResult("stream", "ok", camera.link.text)
        yield from (CheckResult("stream", "warn", text) for text in camera.link.complaints)


def _exposures(camera: SkyCamera, requested_us: Sequence[float]) -> CheckResult:
    info = camera.info
    step = f" in steps of {info.exposure_step_us:g}" if info.exposure_step_us > 0.0 else ""
    text = f"{info.exposure_min_us:.8g} to {info.exposure_max_us:.8g} us{step}"
    beyond = info.unreachable(requested_us)
    if beyond is not None:
        return CheckResult("exposures", "fail", f"{beyond}: change capture.hdr_exposures_us")
    if info.exposure_min_us > _SHORT_US:
        return CheckResult(
            "exposures", "warn", f"{text}; that is long for the sun: see that its disc stays small, or fit a filter"
        )
    return CheckResult("exposures", "ok", text)


def _trial(camera: SkyCamera, exposures_us: Sequence[float]) -> CheckResult:
    """Take some frames, and say how many were complete."""
    lost, silent, refused, last = 0, 0, 0, ""
    for number in range(_TRIAL_FRAMES):
        try:
            camera.expose(exposures_us[number % len(exposures_us)])
        except CameraTimeoutError as error:
            lost, silent, last = lost + 1, silent + isinstance(error, CameraSilentError), str(error)
        except CameraError as error:
            refused, last = refused + 1, str(error)
    complete = _TRIAL_FRAMES - lost - refused
    text = f"{complete} of {_TRIAL_FRAMES} frames complete"
    if complete == _TRIAL_FRAMES:
        return CheckResult("frames", "ok", text)
    if silent == _TRIAL_FRAMES:
        return CheckResult("frames", "fail", f"{text}; {_SILENT}")
    remedy = "look at packet size, MTU and net.core.rmem_max" if lost else "see what else sets the camera"
    return CheckResult("frames", "warn" if complete else "fail", f"{text}; the last fault: {last}; {remedy}")
