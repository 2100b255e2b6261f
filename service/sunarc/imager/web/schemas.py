"""Requests and answers, with units and examples (conventions: docs/conventions.md).

Pixels are (x, y) in px, x right, y down, (0, 0) the centre of the top-left pixel. Directions are apparent (refracted):
zenith and azimuth in degrees, azimuth clockwise from north; or unit vectors, east-north-up. Times are RFC 3339, UTC.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BaseModel, Field, model_validator

import sunarc
from sunarc.imager.archive.values import CalibrationState, CameraRecord, Day, Event, Refit, SightingCounts, SunPoint
from sunarc.imager.runtime.json_fields import EXAMPLE_TIME, Findings, FindingsJson, SolarDate, Time, described
from sunarc.imager.runtime.states import State
from sunarc.imager.runtime.status import (
    CameraStatus,
    CaptureStatus,
    ClockStatus,
    DiskStatus,
    Health,
    Reason,
    WorkerStatus,
)
from sunarc.imager.web.parameters import (
    AnsweringId,
    Answers,
    Body,
    ListOf,
    Next,
    Number,
    Pair,
    Pixel,
    Size,
    Unit,
    Vector,
)
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
    """Detections by solar day, the newest day first; days without one are left out."""

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
    """A decision of an operator, with its reason."""

    reason: str = Field(
        min_length=1,
        max_length=500,
        description="Why, in words; kept in the record.",
        examples=["the dome was cleaned"],
    )


class Acknowledgement(Body):
    """Statement of an operator about an event."""

    reason: str = Field(
        default="seen",
        min_length=1,
        max_length=500,
        description="Why, in words; kept with the event.",
        examples=["the mast was bumped while it was painted"],
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


class BackProjectRequest(Body):
    """Pixels whose directions are wanted."""

    pixels: ListOf[Pixel] = Field(description="(n, 2) px.", examples=[[[871.96, 883.0], [400.0, 912.5]]])


class DirectionDraws(BaseModel):
    """Directions of pixels for each draw, the first axis; null outside the camera's field."""

    zenith_deg: list[Answers] = Field(description="(draws, n) degrees.", examples=[[[0.21], [0.22]]])
    azimuth_deg: list[Answers] = Field(description="(draws, n) degrees.", examples=[[[140.2], [140.9]]])
    direction_enu: list[list[Unit | None]] = Field(
        description="(draws, n) unit vectors, east-north-up.", examples=[[[[0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]]]]
    )


class PixelDraws(BaseModel):
    """Pixels of directions for each draw, the first axis; null outside the camera's field."""

    pixels: list[list[Pair | None]] = Field(
        description="(draws, n) x, y in px.", examples=[[[[400.0, 912.5]], [[400.1, 912.4]]]]
    )


class BackProjectAnswer(BaseModel):
    """Directions of pixels. null outside the camera's field."""

    calibration: Annotated[str, described("Id of the calibration that answered.", "20130514T150508Z-52ee44")]
    zenith_deg: Answers = Field(description="Apparent zenith angle, degrees.", examples=[[0.21, 41.7]])
    azimuth_deg: Answers = Field(description="Degrees clockwise from north.", examples=[[140.2, 262.3]])
    direction_enu: list[Unit | None] = Field(
        description="Unit vectors, east-north-up.", examples=[[[0.0, 0.0, 1.0], [-0.66, -0.09, 0.747]]]
    )
    sigma_deg: Answers = Field(description="1-sigma per axis on the sphere, degrees.", examples=[[0.002, 0.003]])
    inside: list[bool] = Field(description="Within the image and the camera's field.", examples=[[True, True]])
    draws: DirectionDraws | None = Field(default=None, description="Present where draws were asked for.")


class ProjectRequest(Body):
    """Directions whose pixels are wanted: zenith and azimuth (as many of each), or vectors (none of length 0)."""

    zenith_deg: ListOf[Number] | None = Field(
        default=None, description="Apparent zenith, degrees; with azimuth_deg.", examples=[[41.7]]
    )
    azimuth_deg: ListOf[Number] | None = Field(
        default=None, description="Degrees clockwise from north; with zenith_deg.", examples=[[262.3]]
    )
    direction_enu: ListOf[Vector] | None = Field(
        default=None, description="(n, 3) east-north-up; in place of the angles.", examples=[[[0.0, 0.6, 0.8]]]
    )

    @model_validator(mode="after")
    def _one_way(self) -> ProjectRequest:
        angles = (self.zenith_deg is not None, self.azimuth_deg is not None)
        if angles == (False, False) and self.direction_enu is not None:
            if not all(any(vector) for vector in self.direction_enu):
                raise ValueError("direction_enu holds a vector of length 0; leave it out")
            return self
        if angles != (True, True) or self.direction_enu is not None:
            raise ValueError("has not one kind of direction; give zenith_deg and azimuth_deg, or direction_enu")
        if len(self.zenith_deg or ()) != len(self.azimuth_deg or ()):
            raise ValueError("zenith_deg and azimuth_deg differ in length; give one of each for a direction")
        return self


class ProjectAnswer(BaseModel):
    """Pixels of directions. null outside the camera's field."""

    calibration: Annotated[str, described("Id of the calibration that answered.", "20130514T150508Z-52ee44")]
    pixels: list[Pair | None] = Field(description="x, y in px.", examples=[[[400.0, 912.5]]])
    sigma_px: Answers = Field(description="1-sigma per axis, px.", examples=[[0.04]])
    covariance_px2: list[Annotated[list[Pair], Field(min_length=2, max_length=2)] | None] = Field(
        description="Covariance of x and y, px².", examples=[[[[0.0016, 0.0], [0.0, 0.0016]]]]
    )
    inside: list[bool] = Field(description="Within the image and the camera's field.", examples=[[True]])
    draws: PixelDraws | None = Field(default=None, description="Present where draws were asked for.")


class Sun(BaseModel):
    """Where the sun is, and on which pixel the calibration expects it."""

    time: Time
    apparent_zenith: float = Field(description="With refraction, degrees.", examples=[18.2])
    zenith: float = Field(description="Without refraction, degrees.", examples=[18.2])
    azimuth: float = Field(description="Degrees clockwise from north.", examples=[178.1])
    direction_enu: Unit = Field(
        description="Apparent direction, unit vector, east-north-up.", examples=[[0.01, -0.312, 0.95]]
    )
    pixel: Pair | None = Field(description="Expected x, y in px; null when there is none.", examples=[[871.96, 883.0]])
    sigma_px: float | None = Field(
        description="1-sigma per axis of the expected pixel, px; without `at` with the error of the clock that says "
        "what time is now.",
        examples=[0.04],
    )
    inside: bool = Field(
        description="Whether the expected pixel is within the image and the camera's field.", examples=[True]
    )
    calibration: AnsweringId


class SunTrack(BaseModel):
    """The sun's path through one solar day, while it is above the horizon."""

    date: SolarDate
    time: list[Time] = Field(description="In steps, RFC 3339, UTC.", examples=[["2013-05-13T18:30:00Z"]])
    apparent_zenith: list[float] = Field(description="With refraction, degrees.", examples=[[18.2, 18.3]])
    azimuth: list[float] = Field(description="Degrees clockwise from north.", examples=[[178.1, 178.9]])
    pixels: list[Pair | None] = Field(
        description="Expected x, y in px; null outside the field.", examples=[[[400.0, 912.5], None]]
    )
    calibration: AnsweringId


class Residual(BaseModel):
    """A sighting minus the pixel that the current calibration expects."""

    x_px: float = Field(description="Seen minus expected, px.", examples=[0.021])
    y_px: float = Field(description="Seen minus expected, px.", examples=[-0.013])
    distance_px: float = Field(description="Their distance, px.", examples=[0.025])
    distance_deg: float | None = Field(description="The angle between them on the sky, degrees.", examples=[0.0024])
    sigma_px: float | None = Field(
        description="1-sigma per axis of x_px and y_px, by the sighting, its clock and the calibration, px; null where "
        "not known.",
        examples=[0.05],
    )
    apparent_zenith: float = Field(description="Where the sun stood, degrees.", examples=[18.2])
    azimuth: float = Field(description="Where the sun stood, degrees clockwise from north.", examples=[178.1])


@dataclass(frozen=True, slots=True, kw_only=True)
class SunPointWithResidual(SunPoint):
    """One sighting of the sun, with its residual where it is asked for."""

    residual: Annotated[Residual | None, Field(description="With ?residuals=true.")] = None


class SunPoints(BaseModel):
    """Sightings, the newest first."""

    sun_points: Annotated[list[SunPointWithResidual], described("On this page, the newest first.")]
    next: Next
    calibration: Annotated[
        str | None,
        described("Id of the calibration that the residuals are of; null without one.", "20130514T150508Z-52ee44"),
    ] = None


StateNow = Annotated[
    State,
    described("The state in one word, as page, fleet and MQTT show it: the worst that a reason or a note makes."),
]
StateText = Annotated[
    str,
    described(
        "The condition that decides the state, in a sentence.",
        "collecting: first calibration after the first clear day, 212 sightings so far",
    ),
]
NotesNow = Annotated[tuple[Reason, ...], described("What an operator should know and nothing is limited by.")]


class Alive(BaseModel):
    """The process answers."""

    status: Annotated[Literal["alive"], described("Always `alive`.")] = "alive"


class Readiness(BaseModel):
    """Readiness of the service."""

    status: Annotated[Health, described("The worst of the reasons' severities; `ready` without one.")]
    state: StateNow
    state_text: StateText
    reasons: Annotated[tuple[Reason, ...], described("Why it is degraded; empty when it is ready.")]
    notes: NotesNow
    findings: FindingsJson


class Pose(BaseModel):
    """Pose of the camera by its current calibration, in words and in the angles of the paper's Table 2."""

    text: Annotated[str, described("In words.", "image top points to azimuth 214°, tilted 1.2° to the south-west")]
    phi_xz_deg: Annotated[float, described("Azimuth of the x axis, counter-clockwise from east, degrees.", 47.9)]
    theta_zz_deg: Annotated[float, described("Tilt of the optical axis from the vertical, degrees.", 2.5)]
    psi_z_deg: Annotated[float, described("Azimuth of the tilt, clockwise from north, degrees.", 140.2)]
    top_azimuth_deg: Annotated[float, described("Azimuth at the top of the image, degrees.", 214.0)]


Observed = Literal["sun", "stars", "nothing"]


class ObstructionsShown(BaseModel):
    """The learned mask of `/v1/masks/obstructions`."""

    time: Time
    hidden_share: Annotated[float, described("Share of the sky above the horizon that is hidden, 0 to 1.", 0.08)]


class SkyNow(BaseModel):
    """Sun at the time of the frames, kind of observation then, and times of the next sun and stars."""

    sun_elevation_deg: Annotated[float, described("Apparent elevation; below the horizon negative, degrees.", -34.1)]
    observed: Annotated[Observed, described("The sun, the stars of a dark sky where `night.enabled`, or nothing.")]
    sun_from: Annotated[
        Time | None,
        described("From when on images can show the sun; null where it does not rise within 200 days.", EXAMPLE_TIME),
    ]
    stars_from: Annotated[
        Time | None, described("The same of the stars; null also where they are not observed.", EXAMPLE_TIME)
    ]


class Status(BaseModel):
    """State of the service, its workers, camera, clock and disk, and the current calibration."""

    health: Annotated[Health, described("The worst of the reasons' severities; `ready` without one.")]
    state: StateNow
    state_text: StateText
    reasons: Annotated[tuple[Reason, ...], described("Why it is degraded or not ready; empty when it is ready.")]
    notes: NotesNow
    findings: FindingsJson
    version: Annotated[str, described("The software's version.", sunarc.__version__)]
    camera_name: Annotated[str, described("Name of this service's camera.", "imager")]
    started_at: Time
    frame_time: Time = Field(description="The current time of the frames' clock.")
    is_replay: Annotated[bool, described("Whether that clock is of a replay or simulation, not the present.", False)]
    sky: Annotated[SkyNow, described("The sun now, and when it or the stars are observed next.")]
    timezone: Annotated[str, described("IANA name of the site's zone, `site.timezone`.", "Pacific/Auckland")]
    workers: Annotated[tuple[WorkerStatus, ...], described("The service's threads, in the order of their names.")]
    camera: Annotated[CameraStatus | None, described("The camera as it last answered; null before it did.")]
    capture: Annotated[CaptureStatus | None, described("Counts since the start; null before the first cycle.")]
    clock: Annotated[ClockStatus | None, described("The clocks; null before they were checked.")]
    disk_free_bytes: Annotated[
        int | None, described("Free space where the images are, bytes, as `disk` has it.", 82_000_000_000)
    ]
    disk: Annotated[DiskStatus | None, described("The disk with the images; null before it was checked.")]
    last_frame_at: Annotated[Time | None, described("Time of the newest frame.", EXAMPLE_TIME)]
    last_sighting_at: Annotated[Time | None, described("Time of the newest accepted sighting.", EXAMPLE_TIME)]
    calibration: Annotated[CalibrationSummary | None, described("The current calibration; null without one.")]
    pose: Annotated[Pose | None, described("The pose by it; null without one.")]
    last_day: Annotated[DayWithAir | None, described("The newest day that has a verdict; null without one.")]
    image_size: Annotated[Size | None, described("Width, height of the camera's image, px.", [1748, 1748])]
    obstructions: Annotated[ObstructionsShown | None, described("The learned mask; null before a clear day.")]
