"""Bodies of days, calibrations, refits, events and cameras."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import BaseModel, Field

from sunarc.api.schemas.parameters import Body, Next, Number
from sunarc.archive.values import CalibrationState, CameraRecord, Day, Event, Refit, SightingCounts
from sunarc.json_fields import EXAMPLE_TIME, Findings, Time, described
from sunarc.sky.site import PRESSURE_BOUNDS_HPA, TEMPERATURE_BOUNDS_C

_CALIBRATION_ID = "20130514T150508Z-52ee44"
_TEMPERATURE = "Of the air, mean over the hours of sun, degrees Celsius."
_PRESSURE = "Of the air at the camera, not reduced to sea level, hPa (a unit of 100 Pa)."

AirTemperature = Annotated[Number, Field(ge=TEMPERATURE_BOUNDS_C[0], le=TEMPERATURE_BOUNDS_C[1])]
AirPressure = Annotated[Number, Field(ge=PRESSURE_BOUNDS_HPA[0], le=PRESSURE_BOUNDS_HPA[1])]


class DayAirIn(Body):
    """The air that was measured on a day; null, or left out, where it was not: the site's annual mean is assumed."""

    temperature_c: AirTemperature | None = Field(default=None, description=_TEMPERATURE, examples=[31.5])
    pressure_hpa: AirPressure | None = Field(default=None, description=_PRESSURE, examples=[974.5])


class DayAirOut(BaseModel):
    """The air that was measured on a day; null where it was not."""

    temperature_c: float | None = Field(description=_TEMPERATURE, examples=[31.5])
    pressure_hpa: float | None = Field(description=_PRESSURE, examples=[974.5])
    set_at: Time | None = Field(description="When it was given, by the frames' time.", examples=[EXAMPLE_TIME])


@dataclass(frozen=True, slots=True, kw_only=True)
class DayWithAir(Day):
    """Verdict of a solar day, with the arc, the scatter about it (Eq. 20, 27), and the measured air."""

    air: Annotated[
        DayAirOut | None, Field(description="The measured air; null: the site's annual mean is assumed.")
    ] = None


class Days(BaseModel):
    """Days, the newest first."""

    days: Annotated[list[DayWithAir], described("On this page, the newest first.")]
    next: Next


class SightingsByDay(BaseModel):
    """Looks at the sun by solar day, the newest day first; days without a look are left out."""

    days: Annotated[list[SightingCounts], described("The newest first.")]


class CalibrationSummary(BaseModel):
    """A calibration in the history; its document is at /v1/calibrations/{id}."""

    id: Annotated[str, described("Id of the calibration.", _CALIBRATION_ID)]
    camera: Annotated[str, described("Name of the camera.", "imager")]
    state: Annotated[CalibrationState, described("`current` answers now; `retired` answered before.")]
    method: Annotated[str, described("The kind of fit: `robust` or `paper`.", "robust")]
    created_at: Time
    valid_from: Time
    valid_until: Annotated[Time | None, described("Until when it answers; null: until further notice.", EXAMPLE_TIME)]
    pose_epoch: Annotated[str | None, described("Id of the interval in which the camera did not move.", "imager-1")]
    parent: Annotated[
        str | None,
        described("Id of the calibration it was compared with, or copied from; null for the first.", _CALIBRATION_ID),
    ]
    accepted: Annotated[bool, described("Whether its verdict allows it to answer.", True)]
    reasons: Annotated[list[str], described("Of the verdict, in sentences.", ["1-sigma over the sky 0.0099 degrees"])]
    findings: Findings
    pinned: Annotated[bool, described("Whether it stays current whatever a refit finds.", False)]
    rmse_px: Annotated[float | None, described("Of the sightings used, 2-D distance, px.", 0.041)]
    sky_rms_deg: Annotated[float | None, described("1-sigma per axis over the sky, degrees.", 0.0099)]


class Calibrations(BaseModel):
    """Calibrations, the newest first."""

    calibrations: Annotated[list[CalibrationSummary], described("On this page, the newest first.")]
    next: Next


class Decision(Body):
    """What a person decides, and why."""

    reason: str = Field(
        min_length=1,
        max_length=500,
        description="Why, in words; kept in the record.",
        examples=["the dome was cleaned"],
    )


class ClosedEpoch(BaseModel):
    """A pose epoch that was closed as wrong."""

    id: str = Field(description="Of the pose epoch.", examples=["imager-2"])
    calibration: str | None = Field(
        description="Id of the calibration that is current now; null where none was served before it.",
        examples=["20130513T210000Z-3f2a91"],
    )


class Events(BaseModel):
    """Events, the newest first."""

    events: Annotated[list[Event], described("On this page, the newest first.")]
    next: Next


class RefitRequest(Body):
    """Why a refit is wanted."""

    reason: str = Field(
        default="on request", max_length=200, description="Why, in words.", examples=["the dome is clean"]
    )


class Refits(BaseModel):
    """Refits, the newest first."""

    refits: Annotated[list[Refit], described("On this page, the newest first.")]
    next: Next


class Cameras(BaseModel):
    """The cameras that the archive knows, by name."""

    default: str = Field(description="The one that routes without a camera speak of.", examples=["imager"])
    cameras: Annotated[list[CameraRecord], described("In the order of their names.")]
