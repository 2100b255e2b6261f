"""The messages of the service's start and of a replaced camera."""

from __future__ import annotations

from sunarc.findings import Message, Messages

MESSAGES = Messages(
    no_frame_yet=Message(
        "no frame has come from the camera since the service started",
        "A service that is restarted again and again before its first frame is never ready.",
        "wait for the first exposure; if this stays, see the camera's own condition or the log",
    ),
    camera_replaced=Message(
        "camera {model} with serial number {serial} has replaced serial number {serial_before}; calibration "
        "{calibration} was retired",
        "The calibration of another camera is not used.",
        "none: the new camera is calibrated from its own sightings",
    ),
)
