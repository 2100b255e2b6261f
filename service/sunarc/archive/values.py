"""What the archive remembers, as values; times are aware and UTC, lengths in px."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date, datetime
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sunarc.errors import InputError

CalibrationState = Literal["candidate", "current", "retired", "refused"]
DayVerdict = Literal["clear", "partly", "cloudy", "unusable"]
EventSeverity = Literal["info", "warning", "alarm"]
RefitState = Literal["requested", "running", "accepted", "marginal", "refused", "failed", "interrupted"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraRecord:
    """A camera that the archive knows: where it stands and what it makes."""

    name: str
    latitude: float
    longitude: float
    altitude: float
    width: int
    height: int
    model: str = ""
    serial: str = ""
    pixel_format: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseEpoch:
    """An interval in which the camera did not move: from `started_at` until `ended_at` (None: it goes on)."""

    id: str
    camera: str
    started_at: datetime
    ended_at: datetime | None = None
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class SunPoint:
    """One look at the sun, the rejected ones with their reason.

    Attributes
    ----------
    camera, pose_epoch : the camera's name, and the id of the epoch it was in.
    time : mid-exposure.
    method : the detector ("disc", "paper", "import").
    accepted : whether a fit may use it; then `x_px` and `y_px` are known.
    verdict, reason : what was seen, in a word and in a sentence.
    body : what was looked at.
    exposure_us : as the camera read it back; 0 where it is not known.
    x_px, y_px, sigma_px : where, and its 1-sigma per axis; None where there is no answer.
    peak_fraction, background_fraction : share of full scale.
    radius_px, ellipticity, residual_chi2, snr, saturated_px : the shape that was fitted.
    clock_error_s : bound of the clock's error at that moment.
    temperature_c, pressure_hpa : of the air, where measured with the sighting; None takes the day's (`DayAir`).
    """

    camera: str
    pose_epoch: str
    time: datetime
    method: str
    accepted: bool
    verdict: str
    reason: str = ""
    body: str = "sun"
    exposure_us: float = 0.0
    x_px: float | None = None
    y_px: float | None = None
    sigma_px: float | None = None
    peak_fraction: float | None = None
    background_fraction: float | None = None
    radius_px: float | None = None
    ellipticity: float | None = None
    residual_chi2: float | None = None
    snr: float | None = None
    saturated_px: int | None = None
    clock_error_s: float | None = None
    temperature_c: float | None = None
    pressure_hpa: float | None = None

    def __post_init__(self) -> None:
        """Refuse an accepted sighting that is nowhere."""
        if self.accepted and not (_finite(self.x_px) and _finite(self.y_px)):
            raise InputError(
                field="x_px, y_px", problem="an accepted sighting without a pixel", remedy="give finite numbers"
            )


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
    """

    unix_s: NDArray[np.float64]
    pixels: NDArray[np.float64]
    sigma_px: NDArray[np.float64]
    clock_error_s: NDArray[np.float64]
    epoch: NDArray[np.int64]
    epoch_ids: tuple[str, ...]
    ids: NDArray[np.int64]
    temperature: NDArray[np.float64]
    pressure: NDArray[np.float64]

    def select(self, which: NDArray[np.int64] | NDArray[np.bool_]) -> SunPointColumns:
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
class Day:
    """A solar day's verdict, the arc, and the scatter about it (Eq. 20, 27).

    Attributes
    ----------
    n : accepted sightings.
    n_cycles, n_possible : cycles with a sighting on the smooth arc, and cycles that the day had; None: not counted.
    n_observed : cycles in which sun exposures were taken; None: not counted.
    arc_deg, solid_angle_sr : how much of the sky was seen.
    sd_px, rmsd_px : scatter of all sightings about the arc.
    doubtful_clock : share of the sightings whose clock was doubtful.
    pose_offset_deg, pose_offset_sigma_deg : how the camera stood turned against its calibration on average, about the
        axes to the east, to the north and up, and the 1-sigma of each; None where it is not known.
    """

    camera: str
    date: date
    verdict: DayVerdict
    reasons: tuple[str, ...]
    n: int
    n_possible: int
    decided_at: datetime
    arc_deg: float | None = None
    sd_px: float | None = None
    rmsd_px: float | None = None
    n_cycles: int | None = None
    n_observed: int | None = None
    solid_angle_sr: float | None = None
    doubtful_clock: float | None = None
    pose_offset_deg: tuple[float, ...] | None = None
    pose_offset_sigma_deg: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationRecord:
    """A calibration: its document (schema sunarc.calibration/1), with what the archive asks about as fields.

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
    reasons: tuple[str, ...]
    document: Mapping[str, Any] = field(repr=False)
    pinned: bool = False
    damaged: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Refit:
    """A refit that was asked for: by whom or what, how it went, and the calibration it made."""

    id: str
    camera: str
    requested_at: datetime
    reason: str
    state: RefitState = "requested"
    started_at: datetime | None = None
    finished_at: datetime | None = None
    calibration: str | None = None
    message: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Something worth telling: what kind (`bump`, `refit_refused`), how grave, in a sentence, with its numbers."""

    time: datetime
    kind: str
    severity: EventSeverity
    text: str
    camera: str | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    id: int | None = None


def _finite(value: float | None) -> bool:
    return value is not None and math.isfinite(value)
