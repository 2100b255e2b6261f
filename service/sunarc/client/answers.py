"""Answers and events of a service as values."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class BackProjection(NamedTuple):
    """Directions of pixels; NaN outside the camera's field.

    zenith_deg, azimuth_deg : (...) degrees, azimuth clockwise from north.
    direction : (..., 3) unit vectors, east-north-up.
    sigma_deg : (...) 1-sigma per axis on the sphere.
    inside : (...) within the image and the field.
    calibration : id of the calibration that answered.
    """

    zenith_deg: FloatArray
    azimuth_deg: FloatArray
    direction: FloatArray
    sigma_deg: FloatArray
    inside: NDArray[np.bool_]
    calibration: str


class Projection(NamedTuple):
    """Where directions land; NaN beyond the camera's field.

    pixels : (..., 2) x and y in px.
    sigma_px : (...) 1-sigma per axis.
    covariance_px2 : (..., 2, 2).
    inside : (...) within the image and the field.
    calibration : id of the calibration that answered.
    """

    pixels: FloatArray
    sigma_px: FloatArray
    covariance_px2: FloatArray
    inside: NDArray[np.bool_]
    calibration: str


class Located(NamedTuple):
    """Where clouds, or their shadows, are; NaN where there is no place.

    position_m : (..., 3) metres east, north and up of the camera.
    latitude, longitude, altitude : (...) degrees and metres.
    sigma_m : (...) 1-sigma per axis on the ground, by the calibration and the height.
    covariance_m2 : (..., 2, 2) of east and north.
    """

    position_m: FloatArray
    latitude: FloatArray
    longitude: FloatArray
    altitude: FloatArray
    sigma_m: FloatArray
    covariance_m2: FloatArray


class Finding(NamedTuple):
    """A finding: a code of docs/codes.md, its numbers and names, and the sentence, which is for people only."""

    code: str
    data: dict[str, Any]
    text: str


class Condition(NamedTuple):
    """Why the service is degraded or not ready.

    code : of docs/codes.md; of a worker's condition it ends with the worker's name.
    severity : "degraded" or "not_ready".
    data : its numbers and names.
    text, remedy : the sentence, and what to do ("none": nothing).
    since : since when; None where the service does not say.
    """

    code: str
    severity: str
    data: dict[str, Any]
    text: str
    remedy: str
    since: datetime | None = None


def read_conditions(status: Mapping[str, Any]) -> tuple[Condition, ...]:
    """Return the conditions that a status lists."""
    findings = status.get("findings", ())  # version 0.2 has the reasons alone
    data = {finding["code"]: finding["data"] for finding in findings}
    return tuple(
        Condition(
            one["code"],
            one["severity"],
            data.get(one["code"], {}),
            one["text"],
            one["remedy"],
            datetime.fromisoformat(one["since"]) if one.get("since") else None,
        )
        for one in status["reasons"]
    )


class ImagerEvent(NamedTuple):
    """Something that happened.

    kind : "state" (the first one: how things are), "calibration", "bump", "day", "event", "condition_set",
        "condition_cleared", "worker" or "frame".
    data : its numbers and names, see docs/rest.md.
    id : what `Imager.events(after=…)` goes on from.
    """

    kind: str
    data: dict[str, Any]
    id: str


def parsed(lines: Iterable[str]) -> Iterator[ImagerEvent]:
    """Yield the events of a stream's lines; comments and fields of no use here are passed over.

    Raises
    ------
    ValueError, TypeError
        The data are no JSON object.
    """
    fields = {"event": "", "data": "", "id": ""}
    for line in lines:
        name, _, value = line.partition(":")
        if name in fields:
            fields[name] = value.removeprefix(" ")
        if line or not fields["data"]:
            continue
        data = json.loads(fields["data"])
        if not isinstance(data, dict):
            raise TypeError("data that are no object")
        yield ImagerEvent(fields["event"], data, fields["id"])
        fields |= {"event": "", "data": ""}
