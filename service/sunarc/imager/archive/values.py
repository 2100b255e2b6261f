"""Values that the archive stores; times are aware and UTC, lengths in px."""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from datetime import date, datetime
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self, TypeVar, get_args

import numpy as np
from pydantic import Field, computed_field

from sunarc.changes.values import LENS_KINDS, ChangeKind
from sunarc.common.array_types import BoolArray, FloatArray, IntArray, NameArray
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding, joined
from sunarc.imager.runtime.json_fields import EXAMPLE_TIME, Findings, FindingsJson, Returned, SolarDate, Time, described
from sunarc.sky.site import Site

CalibrationState = Literal["candidate", "current", "retired", "refused"]
DayVerdict = Literal["clear", "partly", "cloudy", "unusable"]
EventSeverity = Literal["info", "warning", "alarm"]
NightVerdict = Literal["clear", "partly", "cloudy", "moonlit", "unusable"]
RefitState = Literal["requested", "running", "accepted", "marginal", "refused", "failed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraRecord(Returned):
    """A camera that the archive knows: its site and its image."""

    name: Annotated[str, described("As in /v1/cameras/{camera}/.", "imager")]
    latitude: Annotated[float, described("Degrees, north positive.", 36.604043)]
    longitude: Annotated[float, described("Degrees, east positive.", -97.484856)]
    altitude: Annotated[float, described("Metres above sea level.", 318.0)]
    width: Annotated[int, described("Of its image, px.", 1748)]
    height: Annotated[int, described("Of its image, px.", 1748)]
    model: Annotated[str, described("Vendor and model, as the camera states them.", "Vendor Model")] = ""
    serial: Annotated[str, described("Serial number, as the camera states it.", "SIM-0001")] = ""
    pixel_format: Annotated[str, Field(exclude=True)] = ""

    @classmethod
    def at(cls, site: Site, **fields: Any) -> Self:  # noqa: ANN401 - of several types
        """Return the record of a camera at a site; `fields` are all other fields."""
        return cls(latitude=site.latitude, longitude=site.longitude, altitude=site.altitude, **fields)

    @property
    def site(self) -> Site:
        """Where it stands, in the site's own air."""
        return Site(latitude=self.latitude, longitude=self.longitude, altitude=self.altitude)

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of its image, px."""
        return self.width, self.height


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseEpoch:
    """An interval in which the camera did not move: from `started_at` until `ended_at` (None: it goes on)."""

    id: str
    camera: str
    started_at: datetime
    ended_at: datetime | None = None
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class SunPoint(Returned):
    """One sighting of the sun or of another body; the rejected ones with their reason."""

    camera: Annotated[str, Field(exclude=True)]
    pose_epoch: Annotated[str, described("Id of the interval in which the camera did not move.", "imager-1")]
    time: Time
    method: Annotated[str, described("The detector: `disc`, `paper`, `star`, or `import`.", "disc")]
    accepted: Annotated[bool, described("Whether a fit may use it; then `x_px` and `y_px` are known.", True)]
    verdict: Annotated[str, described("What was detected, in a word.", "clear")]
    findings: Findings = ()
    body: Annotated[str, described("`sun`, `moon`, a planet, or `star:HIP` and its number.", "sun")] = "sun"
    exposure_us: Annotated[float, described("As read back from the camera, µs; 0 where not known.", 47.0)] = 0.0
    x_px: Annotated[float | None, described("To the right, px; null where there is no answer.", 871.96)] = None
    y_px: Annotated[float | None, described("Down, px; null where there is no answer.", 883.0)] = None
    sigma_px: Annotated[float | None, described("1-sigma per axis, px.", 0.04)] = None
    peak_fraction: Annotated[float | None, described("Of the sun, share of full scale.", 0.62)] = None
    background_fraction: Annotated[float | None, described("Of the sky beside the sun, share of full scale.", 0.03)] = (
        None
    )
    radius_px: Annotated[float | None, described("Of the fitted disc, px.", 3.1)] = None
    ellipticity: Annotated[float | None, described("Of the fitted disc: 0 is a circle.", 0.04)] = None
    residual_chi2: Annotated[
        float | None, described("Reduced chi-squared of the fitted disc, a ratio: 1 is noise alone.", 1.1)
    ] = None
    snr: Annotated[float | None, described("Signal to noise, a ratio.", 310.0)] = None
    saturated_px: Annotated[int | None, described("Pixels at full scale, a count.", 0)] = None
    clock_error_s: Annotated[float | None, described("Bound of the error of its time, s.", 0.01)] = None
    temperature_c: Annotated[float | None, Field(exclude=True)] = None  # of the air, measured with the sighting;
    pressure_hpa: Annotated[float | None, Field(exclude=True)] = None  # None takes the day's (`DayAir`)
    file: Annotated[str, Field(exclude=True)] = ""  # name of the image file; "" for a frame of the camera
    ingest_pass: Annotated[int | None, Field(exclude=True)] = None  # 1 without a prediction, 2 with one; None: no file
    folder: Annotated[str, Field(exclude=True)] = ""  # of the image file: "." is the source itself, "" not known

    def __post_init__(self) -> None:
        """Refuse an accepted sighting without a pixel."""
        if self.accepted and not (_is_finite(self.x_px) and _is_finite(self.y_px)):
            raise InputError(
                field="x_px, y_px", problem="an accepted sighting without a pixel", remedy="give finite numbers"
            )

    @computed_field(  # type: ignore[prop-decorator]
        description="Why it was accepted or rejected, in words.", examples=["a disc was fitted, reduced chi² 1.10"]
    )
    @property
    def reason(self) -> str:
        """The findings in a sentence."""
        return joined(self.findings)


@dataclass(frozen=True, slots=True, eq=False)
class SunPointColumns:
    """Sightings as columns, in the order of their times.

    Attributes
    ----------
    unix_s : (n,) seconds since 1970-01-01 UTC, mid-exposure.
    pixels : (n, 2) px.
    sigma_px : (n,) 1-sigma per axis; NaN where not known.
    clock_error_s : (n,) NaN where not known.
    epoch : (n,) index into `epoch_ids`.
    epoch_ids : the pose epochs that occur.
    ids : (n,) the rows' keys.
    temperature, pressure : (n,) of the air, °C and Pa: the sighting's own, else its day's; NaN where not measured.
    body : (n,) names of what was seen: `sun`, `venus`, `star:HIP32349`.
    """

    unix_s: FloatArray
    pixels: FloatArray
    sigma_px: FloatArray
    clock_error_s: FloatArray
    epoch: IntArray
    epoch_ids: tuple[str, ...]
    ids: IntArray
    temperature: FloatArray
    pressure: FloatArray
    body: NameArray

    def select(self, which: IntArray | BoolArray) -> SunPointColumns:
        """Return the sightings that an index or a mask picks, with the epochs that occur among them."""
        present, epoch = np.unique(self.epoch[which], return_inverse=True)
        return SunPointColumns(
            unix_s=self.unix_s[which],
            pixels=self.pixels[which],
            sigma_px=self.sigma_px[which],
            clock_error_s=self.clock_error_s[which],
            epoch=epoch.astype(np.int64),
            epoch_ids=tuple(self.epoch_ids[number] for number in present.tolist()),
            ids=self.ids[which],
            temperature=self.temperature[which],
            pressure=self.pressure[which],
            body=self.body[which],
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class DayAir:
    """The measured air of a camera's solar day; a refraction is computed with it instead of the site's annual mean.

    Attributes
    ----------
    temperature_c, pressure_hpa : means over the hours of sun, °C and hPa; None where not measured.
    set_at : when they were given.
    """

    camera: str
    date: date
    temperature_c: float | None
    pressure_hpa: float | None
    set_at: datetime


@dataclass(frozen=True, slots=True, kw_only=True)
class Day(Returned):
    """Verdict of a solar day, with the arc and the scatter about it (Eq. 20, 27)."""

    camera: Annotated[str, Field(exclude=True)]
    date: SolarDate
    verdict: Annotated[DayVerdict, described("Verdict on the day; its reasons say why.")]
    findings: Findings
    n: Annotated[int, described("Accepted sightings, a count.", 379)]
    n_possible: Annotated[int, described("Cycles that the day had room for, a count.", 418)]
    decided_at: Time
    arc_deg: Annotated[float | None, described("Arc of the sky that was covered, degrees.", 131.2)] = None
    sd_px: Annotated[
        float | None,
        described("Standard deviation of the distance from the day's smooth arc, px (Eq. 20).", 0.05),
    ] = None
    rmsd_px: Annotated[
        float | None, described("Root mean square distance from the day's smooth arc, px (Eq. 27c).", 0.07)
    ] = None
    n_cycles: Annotated[
        int | None, described("Cycles with a sighting on the day's smooth arc; a bracket is one.", 402)
    ] = None
    n_observed: Annotated[
        int | None, described("Cycles in which sun exposures were taken; the verdict is about these.", 418)
    ] = None
    solid_angle_sr: Annotated[float | None, described("Solid angle of the sky that was covered, steradians.", 0.4)] = (
        None
    )
    doubtful_clock: Annotated[float | None, described("Share of the sightings whose clock was doubtful.", 0.0)] = None
    pose_offset_deg: Annotated[
        tuple[float, ...] | None,
        described(
            "Mean rotation of the camera against its calibration: about east, north and up, degrees.",
            [0.003, -0.001, 0.002],
        ),
    ] = None
    pose_offset_sigma_deg: Annotated[
        tuple[float, ...] | None, described("1-sigma of each, degrees.", [0.002, 0.002, 0.004])
    ] = None

    @computed_field(description="Why, in sentences.", examples=[["91 % of the observed slots lie on the arc"]])  # type: ignore[prop-decorator]
    @property
    def reasons(self) -> tuple[str, ...]:
        """The findings as sentences."""
        return tuple(finding.text for finding in self.findings)


@dataclass(frozen=True, slots=True, kw_only=True)
class NightBand(Returned):
    """The stars of a band of zenith angles."""

    from_deg: Annotated[float, described("Zenith angle, degrees.", 50.0)]
    to_deg: Annotated[float, described("Zenith angle, degrees.", 65.0)]
    predicted: Annotated[int, described("Stars to V 4 that the calibration predicts in the images, a count.", 812)]
    found: Annotated[int, described("Of them those that are detected, a count.", 741)]
    transparency: Annotated[
        float | None,
        described("Share of their light that arrives through the air, with the lens's own shading.", 0.74),
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class NightSeries(Returned):
    """Numbers of a night's images, 72 at most, in columns; null where one is not known."""

    time: Annotated[tuple[Time, ...], described("Middles of the exposures.", [EXAMPLE_TIME])]
    n_matched: Annotated[tuple[int, ...], described("Named stars, counts.", [620])]
    cloud_fraction: Annotated[
        tuple[float | None, ...], described("Share of the stars to V 4 that are not seen.", [0.1])
    ]
    limiting_magnitude: Annotated[
        tuple[float | None, ...], described("V at which half as many are detected as of the bright ones.", [5.1])
    ]
    star_fwhm_px: Annotated[
        tuple[float | None, ...], described("Full width at half maximum of bright stars, px.", [2.4])
    ]
    star_ellipticity: Annotated[tuple[float | None, ...], described("1 - minor / major axis, of bright stars.", [0.12])]
    halo: Annotated[
        tuple[float | None, ...], described("Light between 4 and 7 widths around stars, over their own.", [0.01])
    ]
    zero_point: Annotated[
        tuple[float | None, ...], described("V of a star outside the air that gives one count a second.", [10.9])
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Night(Returned):
    """Verdict of a night; null is not known: no image of it was matched."""

    camera: Annotated[str, Field(exclude=True)]
    date: Annotated[SolarDate, Field(serialization_alias="night", description="Local mean solar date of the evening.")]
    verdict: Annotated[
        NightVerdict, described("`moonlit`: no stars were named, and a moon more than half lit was up.", "clear")
    ]
    findings: Findings
    decided_at: Annotated[Time, described("When the night was judged, by the frames' time.", EXAMPLE_TIME)]
    n_images: Annotated[int, described("Exposures of the night, a count.", 48)]
    n_accepted: Annotated[int, described("Of them those whose stars were named, a count.", 46)]
    n_stored: Annotated[int, described("Sightings of stars and planets that were stored, a count.", 1380)]
    n_moon_images: Annotated[int, described("Slots with exposures of the moon, a count.", 12)]
    n_moon_stored: Annotated[int, described("Sightings of the moon that were stored, a count.", 12)]
    n_warm_pixels: Annotated[int, described("Warm pixels that were repaired in its images, a count.", 310)]
    n_stars: Annotated[int, described("Detections in an accepted image, median.", 1730)]
    n_matched: Annotated[int, described("Named stars in an accepted image, median.", 620)]
    star_offset_px: Annotated[
        float | None, described("By how much the stars' centres lie outside of their prediction, at most, px.", 0.1)
    ]
    limiting_magnitude: Annotated[float | None, described("V to which half of the stars are detected.", 5.5)]
    star_fwhm_px: Annotated[float | None, described("Full width of the stars at half maximum, px.", 2.4)]
    cloud_fraction: Annotated[
        float | None, described("Share of the stars to V 4 that are not seen; 1 in images without named stars.", 0.1)
    ]
    transparency: Annotated[
        float | None,
        described("Share of the light that comes through one air mass, by the stars' brightness over the sky.", 0.83),
    ]
    extinction: Annotated[
        float | None, described("Loss of light, magnitudes an air mass, with the shading of the lens.", 0.21)
    ]
    extinction_sigma: Annotated[float | None, described("1-sigma of the extinction, magnitudes.", 0.01)]
    zero_point: Annotated[
        float | None, described("V of a star outside the air that gives one count a second, median.", 10.9)
    ]
    star_ellipticity: Annotated[
        float | None, described("1 - minor / major axis of bright stars, median of the images.", 0.12)
    ]
    halo: Annotated[float | None, described("Light between 4 and 7 widths around stars over their own, median.", 0.01)]
    width_growth: Annotated[
        float | None, described("Width of the stars in the last third of the images over the first.", 1.02)
    ]
    halo_growth: Annotated[
        float | None, described("Growth of the halo from the first to the last third of the images.", 0.002)
    ]
    fading_mag: Annotated[
        float | None, described("Loss of brightness from the first to the last third, magnitudes.", 0.05)
    ]
    zenith_bands: Annotated[tuple[NightBand, ...], described("Stars by zenith angle; empty where none were named.")]
    images: Annotated[NightSeries | None, described("Numbers of its images; null where not asked for, or not known.")]
    picture_time: Annotated[datetime | None, Field(exclude=True)]  # middle of the exposure of its picture


def unusable_night(
    camera: str, evening: date, *, findings: tuple[Finding, ...], decided_at: datetime, n_images: int
) -> Night:
    """Return the verdict on a night of which nothing but the number of its images is known."""
    names = [one.name for one in fields(Night)]
    counts = {name: 0 for name in names if name.startswith("n_")} | {"n_images": n_images}
    unknown: dict[str, Any] = dict.fromkeys(names)
    given = {"camera": camera, "date": evening, "findings": findings, "decided_at": decided_at}
    return Night(**unknown | counts | given | {"verdict": "unusable", "zenith_bands": ()})


@dataclass(frozen=True, slots=True, kw_only=True)
class SightingCounts(Returned):
    """Counts of the images of one solar day in which the sun was sought, by verdict, and the largest clock error."""

    date: SolarDate
    verdicts: Annotated[
        dict[str, int], described("How many looks had a verdict, by verdict.", {"clear": 2210, "hidden": 310})
    ]
    accepted: Annotated[int, described("Looks that were accepted, a count.", 2210)]
    clock_error_s: Annotated[
        float | None, described("Largest bound of the clock's error at one of them, s; null where not known.", 0.01)
    ]


ACTIVATED_BY_OPERATOR = "activated_by_operator"
"""Code of the finding of a calibration that an operator activated; its data have the reason and `decided_at`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationRecord:
    """A calibration: its document (schema sunarc.calibration/2), with the columns of the archive's queries as fields.

    It answers for `valid_from` <= t < `valid_until` (None: until further notice) when its state is current or
    retired; intervals of one camera never overlap. `parent` is the calibration it was compared with or copied from.
    A `pinned` one is current, and stays it whatever a refit finds. A `damaged` one cannot be read from the database
    any more; its document says nothing, and it is never served.
    """

    id: str
    camera: str
    state: CalibrationState
    method: str
    created_at: datetime
    valid_from: datetime
    valid_until: datetime | None
    pose_epoch: str | None
    parent: str | None
    accepted: bool
    findings: tuple[Finding, ...]
    document: Mapping[str, Any] = field(repr=False)
    pinned: bool = False
    damaged: bool = False

    @property
    def reasons(self) -> tuple[str, ...]:
        """The findings as sentences."""
        return tuple(finding.text for finding in self.findings)

    @property
    def decided_at(self) -> datetime:
        """When it was decided that this calibration answers: when it was made, or when an operator activated it."""
        by_hand = (one.data.get("decided_at") for one in self.findings if one.code == ACTIVATED_BY_OPERATOR)
        return max([self.created_at, *(datetime.fromisoformat(str(time)) for time in by_hand if time is not None)])


@dataclass(frozen=True, slots=True, kw_only=True)
class Refit(Returned):
    """A requested refit, its progress, and the calibration it made."""

    id: Annotated[str, described("Id of the refit.", "3f2a9c")]
    camera: Annotated[str, described("Name of the camera.", "imager")]
    requested_at: Time
    reason: Annotated[str, described("Why it was requested.", "the dome is clean")]
    state: Annotated[RefitState, described("`accepted`, `marginal` and `refused`: the verdict on its fit.")] = (
        "requested"
    )
    started_at: Annotated[Time | None, described("When it began; null until then.", EXAMPLE_TIME)] = None
    finished_at: Annotated[Time | None, described("When it ended; null until then.", EXAMPLE_TIME)] = None
    calibration: Annotated[
        str | None, described("Id of the calibration it made, accepted or refused.", "20130514T150508Z-52ee44")
    ] = None
    message: Annotated[
        str, described("How it ended, in a sentence; empty until then.", "1-sigma over the sky 0.0099 degrees")
    ] = ""
    findings: Findings = ()

    @staticmethod
    def asked(camera: str, reason: str, *, at: datetime) -> Refit:
        """Return a refit that is requested at a time, with a new id."""
        return Refit(id=uuid.uuid4().hex, camera=camera, requested_at=at, reason=reason)


@dataclass(frozen=True, slots=True, kw_only=True)
class Event(Returned):
    """Event in the record of a camera or of the service."""

    time: Time
    kind: Annotated[str, described("Stable name of the kind of event.", "bump")]
    severity: Annotated[EventSeverity, described("`alarm`: act now.")]
    text: Annotated[str, described("What happened, in a sentence.", "the camera does not answer")]
    camera: Annotated[str | None, described("Name of the camera; null where it concerns all.", "imager")] = None
    details: Annotated[
        Mapping[str, Any], described("Its numbers; their names carry their units.", {"rmse_px": 0.04})
    ] = field(default_factory=dict)
    id: Annotated[int | None, described("Its number in the archive.", 17)] = None

    @computed_field(description="Whether it stays on top until an operator acknowledges it.", examples=[False])  # type: ignore[prop-decorator]
    @property
    def to_acknowledge(self) -> bool:
        """True where an operator has to acknowledge it."""
        return TO_ACKNOWLEDGE in self.details and ACKNOWLEDGED_AT not in self.details

    @staticmethod
    def of(
        finding: Finding,
        *,
        time: datetime,
        severity: EventSeverity,
        camera: str | None = None,
        kind: str | None = None,
        details: Mapping[str, Any] = MappingProxyType({}),
    ) -> Event:
        """Return the event of a finding.

        Parameters
        ----------
        finding : what happened.
        kind : where it is not the code.
        details : what the finding's data do not say.
        """
        text, data = finding.text, {**finding.data, **details}
        return Event(time=time, kind=kind or finding.code, severity=severity, text=text, camera=camera, details=data)

    @computed_field(  # type: ignore[prop-decorator]
        description="The event as a code with data (docs/codes.md).", examples=[[{"code": "day", "data": {"n": 379}}]]
    )
    @property
    def findings(self) -> FindingsJson:
        """Findings of the event, each a code and data."""
        # numbers and names only: a boolean is none, though Python counts it among the integers
        plain = {key: value for key, value in self.details.items() if type(value) in {str, int, float}}
        return [Finding(event_code(self.kind, self.details), plain).as_json()]


CAMERA_CHANGES: Mapping[str, str] = {
    "bump": "camera_moved",
    **dict.fromkeys(sorted(LENS_KINDS), "lens_changed"),
    "camera_replaced": "camera_replaced",
}
"""Kinds of alarms that an operator has to acknowledge, with the conditions that they set."""
TO_ACKNOWLEDGE = "to_acknowledge"
"""Detail of an event that an operator has to acknowledge."""
ACKNOWLEDGED_AT, ACKNOWLEDGED_BECAUSE = "acknowledged_at", "acknowledged_because"
"""Details of an event that was acknowledged: when, RFC 3339, and the operator's reason."""


def event_code(kind: str, details: Mapping[str, Any]) -> str:
    """Return the code of a stored event, of which the archive has the kind: several codes may share one."""
    if kind not in get_args(ChangeKind):
        return kind
    return "pose_changed" if details.get("searched") else f"changed_{kind}"


def field_values(value: Any) -> dict[str, Any]:  # noqa: ANN401 - any dataclass
    """Return the fields of a value by name, with nested values unchanged (`asdict` converts those too)."""
    return {one.name: getattr(value, one.name) for one in fields(value)}


def _is_finite(value: float | None) -> bool:
    return value is not None and math.isfinite(value)


HousekeepingStep = Literal["hour", "day"]
_Number = TypeVar("_Number", int, float)


@dataclass(frozen=True, slots=True, kw_only=True)
class Housekeeping(Returned):
    """Measurements of an hour or of a UTC day."""

    time: Annotated[Time, described("Beginning of the hour or of the UTC day.", "2013-05-13T18:00:00Z")]
    disk_free_bytes: Annotated[
        int | None, described("Least free space where the images are, bytes; null where not measured.", 82_000_000_000)
    ] = None
    images_bytes: Annotated[
        int | None, described("Largest size of the stored images, bytes; null where not measured.", 12_000_000_000)
    ] = None
    temperature_c: Annotated[
        float | None, described("Mean of the camera's temperatures, degrees Celsius; null without any.", 41.5)
    ] = None
    temperature_min_c: Annotated[float | None, described("The lowest of them, degrees Celsius.", 40.0)] = None
    temperature_max_c: Annotated[float | None, described("The highest of them, degrees Celsius.", 43.0)] = None
    n_temperatures: Annotated[int, described("How many temperatures were read, a count.", 360)] = 0


def merged(one: Housekeeping, other: Housekeeping, *, time: datetime) -> Housekeeping:
    """Return the joined measurements of two spans.

    Parameters
    ----------
    one, other : in any order.
    time : beginning of the span that has both.
    """
    n = one.n_temperatures + other.n_temperatures
    weighted = [part.temperature_c * part.n_temperatures for part in (one, other) if part.temperature_c is not None]
    return Housekeeping(
        time=time,
        disk_free_bytes=_combine_known(min, one.disk_free_bytes, other.disk_free_bytes),
        images_bytes=_combine_known(max, one.images_bytes, other.images_bytes),
        temperature_c=sum(weighted) / n if n else None,
        temperature_min_c=_combine_known(min, one.temperature_min_c, other.temperature_min_c),
        temperature_max_c=_combine_known(max, one.temperature_max_c, other.temperature_max_c),
        n_temperatures=n,
    )


def _combine_known(select: Callable[[list[_Number]], _Number], *values: _Number | None) -> _Number | None:
    known = [value for value in values if value is not None]
    return select(known) if known else None
