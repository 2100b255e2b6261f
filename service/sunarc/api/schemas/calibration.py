"""What is asked and answered, with units and examples (conventions: docs/conventions.md).

Pixels are (x, y) in px, x right, y down, (0, 0) the centre of the top-left pixel. Directions are apparent (refracted):
zenith and azimuth in degrees, azimuth clockwise from north; or unit vectors, east-north-up. Times are RFC 3339, UTC.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic.config import JsonDict

from sunarc.api.schemas.parameters import Answers, Asked, Next, Number, Pair, Pixel, Size, SolarDate, Time, Unit, Vector
from sunarc.api.schemas.record import CalibrationSummary, DayOut
from sunarc.runtime.status import Health, Severity, WorkerState


class BackProjectRequest(Asked):
    """Pixels whose directions are wanted."""

    pixels: list[Pixel] = Field(description="(n, 2) px.", examples=[[[871.96, 883.0], [400.0, 912.5]]])


class BackProjectAnswer(BaseModel):
    """Where pixels look. null where no direction lands on the pixel: outside the field there is no number."""

    calibration: str = Field(description="Id of the calibration that answered.")
    zenith_deg: Answers = Field(description="Apparent zenith angle, degrees.", examples=[[0.21, 41.7]])
    azimuth_deg: Answers = Field(description="Degrees clockwise from north.", examples=[[140.2, 262.3]])
    direction_enu: list[Unit | None] = Field(
        description="Unit vectors, east-north-up.", examples=[[[0.0, 0.0, 1.0], [-0.66, -0.09, 0.747]]]
    )
    sigma_deg: Answers = Field(description="1-sigma per axis on the sphere, degrees.", examples=[[0.002, 0.003]])
    inside: list[bool] = Field(description="Within the image and the camera's field.", examples=[[True, True]])


_TWO_WAYS: tuple[JsonDict, ...] = (
    {
        "required": ["zenith_deg", "azimuth_deg"],
        "properties": {
            "zenith_deg": {"type": "array"},
            "azimuth_deg": {"type": "array"},
            "direction_enu": {"type": "null"},
        },
    },
    {
        "required": ["direction_enu"],
        "properties": {
            "zenith_deg": {"type": "null"},
            "azimuth_deg": {"type": "null"},
            "direction_enu": {"type": "array"},
        },
    },
)


class ProjectRequest(Asked):
    """Directions whose pixels are wanted: zenith and azimuth (as many of each), or vectors (none of length 0)."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"oneOf": [*_TWO_WAYS]})

    zenith_deg: list[Number] | None = Field(default=None, description="Apparent zenith, degrees.", examples=[[41.7]])
    azimuth_deg: list[Number] | None = Field(
        default=None, description="Degrees clockwise from north.", examples=[[262.3]]
    )
    direction_enu: list[Vector] | None = Field(
        default=None, description="(n, 3) east-north-up.", examples=[[[0.0, 0.6, 0.8]]]
    )

    @model_validator(mode="after")
    def _one_way(self) -> ProjectRequest:
        angles = (self.zenith_deg is not None, self.azimuth_deg is not None)
        if angles == (False, False) and self.direction_enu is not None:
            if not all(any(vector) for vector in self.direction_enu):
                raise ValueError("direction_enu holds a vector of length 0")
            return self
        if angles != (True, True) or self.direction_enu is not None:
            raise ValueError("give zenith_deg and azimuth_deg, or direction_enu")
        if len(self.zenith_deg or ()) != len(self.azimuth_deg or ()):
            raise ValueError("zenith_deg and azimuth_deg differ in length")
        return self


class ProjectAnswer(BaseModel):
    """Where directions land. null outside the camera's field."""

    calibration: str = Field(description="Id of the calibration that answered.")
    pixels: list[Pair | None] = Field(description="x, y in px.", examples=[[[400.0, 912.5]]])
    sigma_px: Answers = Field(description="1-sigma per axis, px.", examples=[[0.04]])
    covariance_px2: list[Annotated[list[Pair], Field(min_length=2, max_length=2)] | None] = Field(
        description="Covariance of x and y, px²."
    )
    inside: list[bool] = Field(description="Within the image and the camera's field.", examples=[[True]])


class Sun(BaseModel):
    """Where the sun is, and on which pixel the calibration expects it."""

    time: Time
    apparent_zenith: float = Field(description="With refraction, degrees.", examples=[18.2])
    zenith: float = Field(description="Without refraction, degrees.", examples=[18.2])
    azimuth: float = Field(description="Degrees clockwise from north.", examples=[178.1])
    direction_enu: Unit = Field(
        description="Apparent direction, unit vector, east-north-up.", examples=[[0.01, -0.312, 0.95]]
    )
    pixel: Pair | None = Field(description="Expected x, y in px; null when there is none.")
    sigma_px: float | None = Field(description="1-sigma per axis of the expected pixel, px.")
    inside: bool = Field(
        description="Whether the expected pixel is within the image and the camera's field.", examples=[True]
    )
    calibration: str | None = Field(description="Id of the calibration that answered.")


class SunTrack(BaseModel):
    """The sun's way through one solar day, while it is above the horizon."""

    date: SolarDate
    time: list[Time] = Field(description="In steps, RFC 3339, UTC.", examples=[["2013-05-13T18:30:00Z"]])
    apparent_zenith: list[float] = Field(description="With refraction, degrees.", examples=[[18.2, 18.3]])
    azimuth: list[float] = Field(description="Degrees clockwise from north.", examples=[[178.1, 178.9]])
    pixels: list[Pair | None] = Field(description="Expected x, y in px; null outside the field.")
    calibration: str | None


class Residual(BaseModel):
    """A sighting minus what the current calibration expects."""

    x_px: float = Field(description="Seen minus expected, px.", examples=[0.021])
    y_px: float = Field(description="Seen minus expected, px.", examples=[-0.013])
    distance_px: float = Field(description="Their distance, px.", examples=[0.025])
    distance_deg: float | None = Field(description="The angle between them on the sky, degrees.", examples=[0.0024])
    apparent_zenith: float = Field(description="Where the sun stood, degrees.", examples=[18.2])
    azimuth: float = Field(description="Where the sun stood, degrees clockwise from north.", examples=[178.1])


class SunPointOut(BaseModel):
    """One look at the sun."""

    time: Time
    body: str
    method: str
    exposure_us: float = Field(description="Exposure, µs; 0 where it is not known.")
    pose_epoch: str
    accepted: bool = Field(description="Whether a fit may use it.")
    verdict: str = Field(examples=["clear"])
    reason: str
    x_px: float | None
    y_px: float | None
    sigma_px: float | None = Field(description="1-sigma per axis, px.")
    peak_fraction: float | None = Field(description="Share of full scale.")
    background_fraction: float | None = Field(description="Share of full scale.")
    radius_px: float | None
    ellipticity: float | None
    residual_chi2: float | None
    snr: float | None
    saturated_px: int | None
    clock_error_s: float | None
    residual: Residual | None = Field(default=None, description="With ?residuals=true.")


class SunPoints(BaseModel):
    """Sightings, the newest first."""

    sun_points: list[SunPointOut]
    next: Next
    calibration: str | None = Field(default=None, description="Id of the calibration that the residuals speak of.")


class Alive(BaseModel):
    """The process answers."""

    status: Literal["alive"] = "alive"


class ReasonOut(BaseModel):
    """Why the service is not, or not wholly, ready."""

    code: str = Field(examples=["no_calibration"])
    severity: Severity
    text: str
    remedy: str


class Readiness(BaseModel):
    """Whether the service can be relied on."""

    status: Health
    reasons: list[ReasonOut]


class WorkerOut(BaseModel):
    """One worker."""

    name: str
    state: WorkerState
    heartbeat_age_s: float | None = Field(description="Seconds since its last sign of life.")
    restarts: int
    last_error: str | None


class CameraOut(BaseModel):
    """The camera as it last answered."""

    name: str
    connected: bool
    address: str
    model: str
    serial: str
    pixel_format: str
    temperature_c: float | None = Field(description="The camera's own, degrees Celsius.")


class CaptureOut(BaseModel):
    """What capture has counted since the service started; times in real seconds after a slot."""

    cycles: int
    complete: int
    missed: int
    sun_missed: int
    sun_dropped: int
    frames: int
    retries: int
    losses: int
    refusals: int
    doubts: int
    failures: int
    openings: int
    jitter_s: float | None
    jitter_max_s: float | None
    hdr_s: float | None


class ClockOut(BaseModel):
    """Whether the host's clock is disciplined, the bound of its error, and when the frames' clock was last set."""

    synchronised: bool | None
    max_error_s: float | None
    last_step_s: float | None = Field(description="Seconds that the frames' clock was set by; positive is forward.")
    last_step_at: Time | None


class DiskOut(BaseModel):
    """What is free where the images are, and what they take."""

    free_bytes: int
    images_bytes: int
    oldest_image_at: Time | None


class Status(BaseModel):
    """Everything at a glance."""

    health: Health
    reasons: list[ReasonOut]
    version: str
    camera_name: str
    started_at: Time
    frame_time: Time = Field(description="The time that the frames say it is.")
    workers: list[WorkerOut]
    camera: CameraOut | None
    capture: CaptureOut | None
    clock: ClockOut | None
    disk_free_bytes: int | None
    disk: DiskOut | None
    last_frame_at: Time | None
    last_sighting_at: Time | None
    calibration: CalibrationSummary | None
    last_day: DayOut | None
    image_size: Size | None = Field(description="Width, height of the camera's image, px.")
