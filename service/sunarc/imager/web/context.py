"""Dependencies of the routes of one application, and their caches."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable, MutableMapping
from dataclasses import dataclass, field, replace
from datetime import date, datetime
from pathlib import Path
from typing import Any, Generic, TypeVar

from starlette.convertors import Convertor, register_url_convertor
from starlette.requests import Request

from sunarc.calibration.answers.ageing import age_step_days, aged
from sunarc.calibration.answers.direction_table import Lookup
from sunarc.calibration.answers.error_model import Ensemble
from sunarc.calibration.model.result import Calibration
from sunarc.common.errors import InputError, NotFoundError
from sunarc.formats.calibration_document import uncertainty_document
from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.images import ImageStore
from sunarc.imager.archive.move_pictures import MovePictures
from sunarc.imager.archive.obstructions import ObstructionLearner
from sunarc.imager.archive.values import CalibrationRecord, Refit
from sunarc.imager.runtime.status import StatusSnapshot
from sunarc.imager.web.options import ApiOptions
from sunarc.imager.web.problems import NoCalibrationError
from sunarc.sky.days import solar_date
from sunarc.sky.site import Site

_CACHE_SIZE = 8
_AGES = 32
"""Documents of 100 kB that are kept, of as many ages or states of calibrations."""
CALIBRATION, BEST = "calibration", "best"
"""Name of the query parameter that chooses a calibration, and its value for the least uncertain of the pose epoch."""
CAMERA_PREFIX = "/v1{camera:of_camera}"
"""Prefix of the routes of one camera: `/v1`, or `/v1/cameras/NAME`."""

DECIDED_AT = "sunarc.decided_at"
"""Key of a request's scope: when it was decided which calibration answers for the moment that is asked for."""
PictureList = Callable[[datetime | None, datetime | None, int], list[tuple[datetime, Path]]]
"""Returns times and files of at most so many pictures with since <= time < until, the newest first."""
Input = TypeVar("Input")
Value = TypeVar("Value")


class _OfCamera(Convertor[str]):
    """Path converter that reads `/cameras/NAME` as a name, and nothing at all as this service's own camera."""

    regex = "(?:/cameras/[^/]+)?"

    def convert(self, value: str) -> str:
        return value.removeprefix("/cameras/")

    def to_string(self, value: str) -> str:
        return f"/cameras/{value}" if value else ""


register_url_convertor("of_camera", _OfCamera())


class SingleFlightCache(Generic[Input, Value]):
    """Cache of recent answers: each made once, however many ask at the same time.

    Parameters
    ----------
    make : makes it.
    key : what makes it another one.
    most : so many are kept.
    """

    def __init__(self, make: Callable[[Input], Value], *, key: Callable[[Input], str], most: int = _CACHE_SIZE) -> None:
        self._make, self._most, self._key = make, most, key
        self._lock = threading.Lock()
        self._cache: OrderedDict[str, Value] = OrderedDict()

    def cached_value(self, requested: Input) -> Value | None:
        """Return a value that is there already, at once."""
        return self._cache.get(self._key(requested))

    def get(self, requested: Input) -> Value:
        """Return a value; it may have to be made."""
        key = self._key(requested)
        # Made under the lock: who asks for the same meanwhile waits for it, and does not make it again.
        with self._lock:
            found = self._cache.get(key)
            if found is None:
                found = self._cache[key] = self._make(requested)
            self._cache.move_to_end(key)
            while len(self._cache) > self._most:
                self._cache.popitem(last=False)
            return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampling:
    """Which draws of a calibration are asked for: at least one; the seed decides them."""

    calibration: CalibrationRecord
    draws: int
    seed: int

    @property
    def key(self) -> str:
        """Return the key of the ensemble."""
        return f"{model_key(self.calibration)}/{self.seed}/{self.draws}"


class Ages:
    """Calibrations as they hold at a time: away from their sightings the uncertainty grows (`aged`).

    Parameters
    ----------
    archive : where they are.
    """

    def __init__(self, archive: Archive) -> None:
        self._archive = archive
        self._grown = SingleFlightCache(self._grow, key=_record_key, most=_AGES)

    def record(self, record: CalibrationRecord, time: datetime) -> CalibrationRecord:
        """Return a stored record with the document that holds at a time; the same where it does not differ."""
        try:
            days = 0 if record.damaged else age_step_days(self._archive.calibrations.model(record.id), time.timestamp())
        except InputError:  # another version wrote the document, and who needs its model is refused with the reason
            days = 0
        if days == 0:
            return record
        asked = replace(record, document={**record.document, "uncertainty": {"aged_days": days}})
        return self._grown.get(asked)[0]

    def model(self, record: CalibrationRecord) -> Calibration:
        """Return the calibration of a record, as stored or as `record` returned it."""
        return self._grown.get(record)[1] if aged_days(record) else self._archive.calibrations.model(record.id)

    def _grow(self, asked: CalibrationRecord) -> tuple[CalibrationRecord, Calibration]:
        model = aged(self._archive.calibrations.model(asked.id), aged_days(asked))
        return replace(asked, document={**asked.document, "uncertainty": uncertainty_document(model)}), model


def aged_days(record: CalibrationRecord) -> int:
    """Return the age whose uncertainty a record's document states, days; 0 of one as it is stored."""
    return int(record.document.get("uncertainty", {}).get("aged_days", 0))


def model_key(record: CalibrationRecord) -> str:
    """Return a text that identifies a record's model, which never changes under one id and age."""
    return f"{record.id}/{aged_days(record)}"


def _record_key(record: CalibrationRecord) -> str:
    """Return a text that changes with the time that a record answers for, too."""
    return f"{model_key(record)}/{record.state}/{record.pinned}/{record.valid_until}"


class DaySites:
    """Cameras' sites in the measured air of a day, as last read; read again after anything was written to the archive.

    Parameters
    ----------
    archive : where the measured air is.
    """

    def __init__(self, archive: Archive) -> None:
        self._archive = archive
        self._sites: dict[str, tuple[int, date, Site]] = {}

    def get(self, camera: str, site: Site, day: date) -> Site:
        """Return a camera's site in the measured air of a solar day."""
        # Before the site, so that a commit between the two is seen at the next question.
        revision = self._archive.revision()
        cached = self._sites.get(camera)
        if cached is None or cached[:2] != (revision, day):
            cached = self._sites[camera] = (revision, day, self._archive.days.site_in_measured_air(camera, site, day))
        return cached[2]


@dataclass(frozen=True, slots=True, kw_only=True)
class ApiContext:
    """The collaborators of one application (see `create_app`).

    `timezone` and `is_replay` are for displays: the zone of local times, and whether the frames' clock is a replay's.
    `sun_zenith_deg` and `observes_stars` say when images show the sun, and whether stars are observed in the dark.
    `chosen` is the calibration that a request asks to be answered with: an id, or "best"; None for the one of the time.
    `scope` is that of a request for another time than now: what answers it is noted there (`Boundary`).
    """

    archive: Archive
    camera: str
    site: Site
    status: Callable[[], StatusSnapshot]
    request_refit: Callable[[str], Refit]
    frame_clock: Callable[[], datetime]
    latest_image: Callable[[], Path | None]
    images: ImageStore | None
    moves: MovePictures | None
    obstructions: ObstructionLearner | None
    options: ApiOptions
    token: bytes | None = field(repr=False)
    sites: DaySites
    ages: Ages
    ready: SingleFlightCache[CalibrationRecord, Lookup]
    ensembles: SingleFlightCache[Sampling, Ensemble]
    stopping: Callable[[], bool] = lambda: False
    pictures: PictureList | None = None
    chosen: str | None = None
    timezone: str = "UTC"
    is_replay: bool = False
    sun_zenith_deg: float = 90.0
    observes_stars: bool = False
    scope: MutableMapping[str, Any] | None = field(default=None, repr=False)

    def of(self, request: Request) -> ApiContext:
        """Return the serving state of the camera in a request's path, by the calibration that its query names.

        Where the path names no camera it is this service's own.
        """
        name = request.path_params["camera"]
        if name == self.camera == "":
            remedy = "name one: /v1/cameras/{camera}/…, see /v1/cameras"
            raise NotFoundError(field="camera", problem="a hub has no camera of its own", remedy=remedy)
        selected, asked = self.named(name), request.query_params
        if not asked.keys() & {CALIBRATION, "at"}:
            return selected
        return replace(selected, chosen=asked.get(CALIBRATION), scope=request.scope if "at" in asked else None)

    def answering(self, request: Request, at: datetime | None) -> tuple[ApiContext, CalibrationRecord]:
        """Return the serving state as `of` does, and its calibration that answers now, or for the moment `at`."""
        selected = self.of(request)
        return selected, selected.record(at)

    def named(self, name: str) -> ApiContext:
        """Return the serving state of a camera; an empty name is this service's own."""
        return self if name in ("", self.camera) else self._other_camera(name)

    def _other_camera(self, name: str) -> ApiContext:
        """Return the archive's record of a camera that another service drives."""
        record = self.archive.cameras.get(name)
        if record is None:
            raise NotFoundError(field="camera", problem=f"there is no camera {name}", remedy="see /v1/cameras")
        return replace(
            self,
            camera=name,
            site=record.site,
            latest_image=lambda: None,
            images=None,
            moves=None,
            obstructions=None,
            pictures=None,
            request_refit=refuse_refit,
        )

    def site_with_air_at(self, time: datetime) -> Site:
        """Return the site in the measured air of the solar day of a moment, in its own where nothing was measured."""
        return self.site_in_measured_air(solar_date(time.timestamp(), longitude=self.site.longitude))

    def site_in_measured_air(self, day: date) -> Site:
        """Return the site in the measured air of a solar day, in its own where nothing was measured."""
        return self.sites.get(self.camera, self.site, day)

    def record(self, at: datetime | None) -> CalibrationRecord:
        """Return the calibration that answers now, or for the moment `at`; NotFoundError without one."""
        record = self.record_or_none(at)
        if record is None:
            remedy = "wait for a clear day, or see /v1/calibrations for what there is"
            if at is None or self.archive.calibrations.current(self.camera) is None:
                raise NoCalibrationError(field="calibration", problem="no calibration is current", remedy=remedy)
            raise NotFoundError(field="at", problem=f"no calibration answers for {at.isoformat()}", remedy=remedy)
        return record

    def calibration(self, calibration_id: str, *, field_name: str = "id") -> CalibrationRecord:
        """Return this camera's calibration of an id; NotFoundError without one."""
        try:
            record = self.archive.calibrations.get(calibration_id)
        except NotFoundError as error:
            raise NotFoundError(field=field_name, problem=error.problem, remedy=error.remedy) from None
        if record.camera != self.camera:
            problem = f"calibration {calibration_id} is another camera's"
            raise NotFoundError(field=field_name, problem=problem, remedy="see /v1/cameras")
        return record

    def calibration_or_none(self, at: datetime | None) -> tuple[CalibrationRecord, Calibration] | None:
        """Return the calibration that answers, in both its forms; None without one."""
        record = self.record_or_none(at)
        return None if record is None else (record, self.ages.model(record))

    def record_or_none(self, at: datetime | None) -> CalibrationRecord | None:
        """Return the calibration that answers, with the uncertainty that it has then; None without one."""
        if self.chosen is None:
            record = self.archive.calibrations.current(self.camera, at=at)
        else:
            record = self._find_most_certain(at) if self.chosen == BEST else self._require_not_refused(self.chosen)
        if record is not None and self.scope is not None:
            self.scope.setdefault(DECIDED_AT, record.decided_at)
        return None if record is None else self.ages.record(record, at or self.frame_clock())

    def _require_not_refused(self, calibration_id: str) -> CalibrationRecord:
        """Return a calibration that may answer: none that its verdict refused."""
        record = self.calibration(calibration_id, field_name=CALIBRATION)
        if not record.accepted or record.damaged:
            why = "is damaged" if record.damaged else "was refused by its verdict"
            remedy = f"see its reasons in /v1/calibrations/{calibration_id}"
            raise NotFoundError(field=CALIBRATION, problem=f"{calibration_id} {why}", remedy=remedy)
        return record

    def _find_most_certain(self, at: datetime | None) -> CalibrationRecord | None:
        """Return the accepted calibration of the pose epoch that answers with the least uncertainty over the sky."""
        answering = self.archive.calibrations.current(self.camera, at=at)
        if answering is None:
            return None
        rivals = [
            record
            for record in self.archive.calibrations.find(self.camera)
            if record.pose_epoch == answering.pose_epoch and record.accepted and not record.damaged
        ]
        return min([answering, *rivals], key=_get_sky_rms_deg)


def _get_sky_rms_deg(record: CalibrationRecord) -> float:
    value = record.document.get("uncertainty", {}).get("sky_rms_deg")
    return math.inf if value is None else float(value)


def refuse_refit(_reason: str) -> Refit:
    """Refuse a refit of a camera that another service drives."""
    raise InputError(
        field="camera", problem="another service solves this camera", remedy="ask the service that drives it"
    )
