"""Bodies of days, calibrations, refits, events and cameras."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field

from sunarc.api.schemas.parameters import Asked, Next, Number, SolarDate, Time
from sunarc.archive import CalibrationState, DayVerdict, EventSeverity, RefitState
from sunarc.sky import PRESSURE_BOUNDS_PA, TEMPERATURE_BOUNDS_C

_PA_PER_HPA = 100.0
_TEMPERATURE = "Of the air, mean over the hours of sun, degrees Celsius."
_PRESSURE = "Of the air at the camera, not reduced to sea level, hPa (a unit of 100 Pa)."

AirTemperature = Annotated[Number, Field(ge=TEMPERATURE_BOUNDS_C[0], le=TEMPERATURE_BOUNDS_C[1])]
AirPressure = Annotated[Number, Field(ge=PRESSURE_BOUNDS_PA[0] / _PA_PER_HPA, le=PRESSURE_BOUNDS_PA[1] / _PA_PER_HPA)]


class DayAirIn(Asked):
    """The air that was measured on a day; null, or left out, where it was not: the site's annual mean is assumed."""

    temperature_c: AirTemperature | None = Field(default=None, description=_TEMPERATURE, examples=[31.5])
    pressure_hpa: AirPressure | None = Field(default=None, description=_PRESSURE, examples=[974.5])


class DayAirOut(BaseModel):
    """The air that was measured on a day; null where it was not."""

    temperature_c: float | None = Field(description=_TEMPERATURE, examples=[31.5])
    pressure_hpa: float | None = Field(description=_PRESSURE, examples=[974.5])
    set_at: Time | None = Field(description="When it was given, by the frames' time.")


class DayOut(BaseModel):
    """What a solar day was worth."""

    date: SolarDate
    verdict: DayVerdict
    reasons: list[str]
    n: int = Field(description="Accepted sightings.")
    n_cycles: int | None = Field(description="Cycles with a sighting on the day's smooth arc; a bracket is one.")
    n_possible: int = Field(description="Cycles that the day had room for.")
    n_observed: int | None = Field(description="Cycles in which sun exposures were taken; the verdict speaks of these.")
    arc_deg: float | None = Field(description="Arc of the sky that was covered, degrees.")
    solid_angle_sr: float | None = Field(description="Solid angle of the sky that was covered, steradians.")
    sd_px: float | None = Field(description="Scatter about the day's smooth arc, px per axis (Eq. 20).")
    rmsd_px: float | None = Field(description="Scatter about the day's smooth arc, px in distance (Eq. 27c).")
    doubtful_clock: float | None = Field(description="Share of the sightings whose clock was doubtful.")
    pose_offset_deg: list[float] | None = Field(
        description="How the camera stood turned against its calibration: about east, north and up, degrees."
    )
    pose_offset_sigma_deg: list[float] | None = Field(description="1-sigma of each, degrees.")
    air: DayAirOut | None = Field(
        default=None, description="The measured air; null: the site's annual mean is assumed."
    )
    decided_at: Time


class Days(BaseModel):
    """Days, the newest first."""

    days: list[DayOut]
    next: Next


class CalibrationSummary(BaseModel):
    """A calibration in the history; its document is at /v1/calibrations/{id}."""

    id: str
    camera: str
    state: CalibrationState
    method: str
    created_at: Time
    valid_from: Time
    valid_until: Time | None
    pose_epoch: str | None
    parent: str | None
    accepted: bool
    reasons: list[str]
    pinned: bool = Field(description="Whether it stays current whatever a refit finds.")
    rmse_px: float | None = Field(description="Of the sightings used, 2-D distance, px.")
    sky_rms_deg: float | None = Field(description="1-sigma per axis over the sky, degrees.")


class Calibrations(BaseModel):
    """Calibrations, the newest first."""

    calibrations: list[CalibrationSummary]
    next: Next


class Decision(Asked):
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


class EventOut(BaseModel):
    """Something that happened."""

    id: int | None = Field(description="Its number in the archive.", examples=[17])
    time: Time
    kind: str = Field(examples=["bump"])
    severity: EventSeverity
    text: str
    camera: str | None
    details: dict[str, object]


class Events(BaseModel):
    """Events, the newest first."""

    events: list[EventOut]
    next: Next


class RefitRequest(Asked):
    """Why a refit is wanted."""

    reason: str = Field(default="on request", max_length=200)


class RefitOut(BaseModel):
    """A refit, and how it went."""

    id: str
    camera: str
    state: RefitState
    reason: str
    requested_at: Time
    started_at: Time | None
    finished_at: Time | None
    calibration: str | None = Field(description="Id of the calibration it made, accepted or refused.")
    message: str


class Refits(BaseModel):
    """Refits, the newest first."""

    refits: list[RefitOut]
    next: Next


class CameraRecordOut(BaseModel):
    """A camera that the archive knows: where it stands and what it makes."""

    name: str = Field(description="As in /v1/cameras/{camera}/.", examples=["imager"])
    latitude: float = Field(description="Degrees, north positive.", examples=[36.604043])
    longitude: float = Field(description="Degrees, east positive.", examples=[-97.484856])
    altitude: float = Field(description="Metres above sea level.", examples=[318.0])
    width: int = Field(description="Of its image, px.", examples=[1748])
    height: int = Field(description="Of its image, px.", examples=[1748])
    model: str = Field(description="Vendor and model, as the camera tells them.", examples=["Vendor Model"])
    serial: str = Field(description="Serial number, as the camera tells it.", examples=["SIM-0001"])


class Cameras(BaseModel):
    """The cameras that the archive knows, by name."""

    default: str = Field(description="The one that routes without a camera speak of.", examples=["imager"])
    cameras: list[CameraRecordOut]
