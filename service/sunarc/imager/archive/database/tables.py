"""The tables of the head revision, and the types of their columns; a column carries the name of the value's field.

A stored value that cannot be read (a flipped bit, a hand) is None, and never an exception. A row that lacks a value
which it must have is then left out of what is returned (see `store.values_of`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from datetime import date, datetime
from typing import Any, get_args

from pydantic import TypeAdapter, ValidationError
from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Column,
    ColumnElement,
    Date,
    Dialect,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    Table,
    Text,
    TypeDecorator,
    UniqueConstraint,
    false,
    text,
)
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.sql.functions import GenericFunction

from sunarc.common.findings import Finding, from_json
from sunarc.common.utc import from_microseconds, to_microseconds
from sunarc.imager.archive.database.connections import parsed_json
from sunarc.imager.archive.values import (
    CalibrationState,
    DayVerdict,
    EventSeverity,
    HousekeepingStep,
    NightBand,
    NightSeries,
    NightVerdict,
    RefitState,
)


class UtcTime(TypeDecorator[datetime]):
    """An aware UTC time as whole microseconds since 1970, so that equality and order are exact."""

    impl = BigInteger
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> int | None:  # noqa: ARG002 - SQLAlchemy's
        """Return the number to store."""
        return None if value is None else to_microseconds(value)

    def process_result_value(self, value: Any | None, dialect: Dialect) -> datetime | None:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored time, aware."""
        if not isinstance(value, int):
            return None
        try:
            return from_microseconds(value)
        except OverflowError:  # no year that a datetime can hold
            return None


class Number(TypeDecorator[float]):
    """A number; a text that stands in its place is None, and so is NaN: SQLite stores it as NULL."""

    impl = Float
    cache_ok = True

    def process_bind_param(self, value: float | None, dialect: Dialect) -> float | None:  # noqa: ARG002 - SQLAlchemy's
        """Return the number to store."""
        return None if value is None or math.isnan(value) else value

    def process_result_value(self, value: Any | None, dialect: Dialect) -> float | None:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored number."""
        return value if isinstance(value, int | float) else None


class Count(TypeDecorator[int]):
    """A whole number; what stands in its place is None."""

    impl = Integer
    cache_ok = True

    def process_result_value(self, value: Any | None, dialect: Dialect) -> int | None:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored number."""
        return value if isinstance(value, int) else None


class CalendarDate(TypeDecorator[date]):
    """A date, as SQLAlchemy's `Date` stores it: ISO 8601 text in SQLite."""

    impl = Date
    cache_ok = True

    def result_processor(self, dialect: Dialect, coltype: object) -> Callable[[Any], date | None]:  # noqa: ARG002 - SQLAlchemy's
        """Return what reads the stored text."""
        return _date


class Word(TypeDecorator[str]):
    """One word of a few; another one is None."""

    impl = Text
    cache_ok = True

    def __init__(self, words: tuple[str, ...]) -> None:
        super().__init__()
        self.words = words

    def process_result_value(self, value: Any | None, dialect: Dialect) -> str | None:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored word."""
        return value if value in self.words else None


class FindingTuple(TypeDecorator[tuple[Finding, ...]]):
    """Findings, as a JSON list of objects; sentences of version 0.2 become findings without a code."""

    impl = JSON
    cache_ok = True

    def process_bind_param(self, value: tuple[Finding, ...] | None, dialect: Dialect) -> list[dict[str, Any]]:  # noqa: ARG002 - SQLAlchemy's
        """Return the list to store."""
        return [finding.as_json() for finding in value or ()]

    def process_result_value(self, value: Any | None, dialect: Dialect) -> tuple[Finding, ...]:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored findings; none where they cannot be read."""
        return tuple(from_json(one) for one in value) if isinstance(value, list) else ()


class FindingText(TypeDecorator[tuple[Finding, ...]]):
    """Findings, as the text of a JSON list, empty without any; a sentence of revision 0017 and before is `uncoded`."""

    impl = Text
    cache_ok = True

    def process_bind_param(self, value: tuple[Finding, ...] | None, dialect: Dialect) -> str:  # noqa: ARG002 - SQLAlchemy's
        """Return the text to store; equal findings have equal texts."""
        return json.dumps([one.as_json() for one in value], separators=(",", ":")) if value else ""

    def process_result_value(self, value: Any | None, dialect: Dialect) -> tuple[Finding, ...]:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored findings."""
        return findings_of_text(value)


def findings_of_text(text: Any | None) -> tuple[Finding, ...]:  # noqa: ANN401 - whatever is stored
    """Return the findings of a text of `FindingText`, or of a sentence."""
    stored = parsed_json(str(text)) if str(text).startswith("[{") else [text] if text else []
    return tuple(from_json(one) for one in (stored if isinstance(stored, list) else [text]))


class NumberTuple(TypeDecorator[tuple[float, ...]]):
    """So many numbers, as a JSON list; None where there are none."""

    impl = JSON(none_as_null=True)
    cache_ok = True

    def __init__(self, length: int) -> None:
        super().__init__()
        self.length = length

    def process_bind_param(self, value: tuple[float, ...] | None, dialect: Dialect) -> list[float] | None:  # noqa: ARG002 - SQLAlchemy's
        """Return the list to store."""
        return None if value is None else list(value)

    def process_result_value(self, value: Any | None, dialect: Dialect) -> tuple[float, ...] | None:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored numbers."""
        if not isinstance(value, list) or len(value) != self.length:
            return None
        return tuple(value) if all(isinstance(number, int | float) for number in value) else None


class JsonOf(TypeDecorator[Any]):
    """A value of a type, as JSON; None where what is stored is none of it, as with a field that is missing.

    Parameters
    ----------
    kind : the type, as pydantic reads and writes it.
    """

    impl = JSON(none_as_null=True)
    cache_ok = True

    def __init__(self, kind: type[Any]) -> None:
        super().__init__()
        self.kind = kind
        self._adapter: TypeAdapter[Any] = TypeAdapter(kind)

    def process_bind_param(self, value: Any | None, dialect: Dialect) -> Any:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the JSON to store."""
        return None if value is None else self._adapter.dump_python(value, mode="json")

    def process_result_value(self, value: Any | None, dialect: Dialect) -> Any:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored value."""
        try:
            return None if value is None else self.read(value)
        except ValidationError:
            return None

    def read(self, value: object) -> Any:  # noqa: ANN401 - of the type
        """Return the value of JSON; pydantic's `ValidationError`, which is a `ValueError`, where it is none."""
        return self._adapter.validate_python(value)

    def schema(self) -> dict[str, Any]:
        """Return the JSON Schema of what is read."""
        return self._adapter.json_schema()


class JsonObject(TypeDecorator[dict[str, Any]]):
    """A JSON object; empty where it cannot be read."""

    impl = JSON
    cache_ok = True

    def process_result_value(self, value: Any | None, dialect: Dialect) -> dict[str, Any]:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored object."""
        return value if isinstance(value, dict) else {}


def stored_bytes(column: ColumnElement[Any]) -> ColumnElement[bytes]:
    """Return the bytes of a JSON column as they are stored."""
    return _StoredBytes(column)


class _StoredBytes(GenericFunction[bytes]):
    type = LargeBinary()
    inherit_cache = True


@compiles(_StoredBytes)
def _cast_to_blob(element: _StoredBytes, compiler: SQLCompiler, **options: Any) -> str:  # noqa: ANN401 - SQLAlchemy's
    return f"CAST({compiler.process(element.clauses, **options)} AS BLOB)"


@compiles(_StoredBytes, "postgresql")
def _convert_to_bytes(element: _StoredBytes, compiler: SQLCompiler, **options: Any) -> str:  # noqa: ANN401 - SQLAlchemy's
    return f"convert_to(({compiler.process(element.clauses, **options)})::text, 'UTF8')"


class stored_as(GenericFunction[bool]):  # noqa: N801 - a function of SQL
    """Whether a column's value is stored as SQLite's `kind`; on PostgreSQL: whether there is one."""

    type = Boolean()
    inherit_cache = True


@compiles(stored_as)
def _compare_type(element: stored_as, compiler: SQLCompiler, **options: Any) -> str:  # noqa: ANN401 - SQLAlchemy's
    column, kind = element.clauses
    return f"(typeof({compiler.process(column, **options)}) = {compiler.process(kind, **options)})"


class is_number(GenericFunction[bool]):  # noqa: N801 - a function of SQL
    """Whether a column's value is a number; on PostgreSQL: whether there is one."""

    type = Boolean()
    inherit_cache = True


@compiles(is_number)
def _compare_order(element: is_number, compiler: SQLCompiler, **options: Any) -> str:  # noqa: ANN401 - SQLAlchemy's
    # texts and blobs come after all numbers; millions of names of types would take twice as long to compare
    return f"({compiler.process(next(iter(element.clauses)), **options)} <= 9e999)"


@compiles(stored_as, "postgresql")
@compiles(is_number, "postgresql")
def _compare_null(element: stored_as | is_number, compiler: SQLCompiler, **options: Any) -> str:  # noqa: ANN401 - SQLAlchemy's
    return f"({compiler.process(next(iter(element.clauses)), **options)} IS NOT NULL)"


def _date(stored: object) -> date | None:
    if isinstance(stored, date):
        return stored
    try:
        return date.fromisoformat(stored) if isinstance(stored, str) else None
    except ValueError:
        return None


metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s",
        "pk": "pk_%(table_name)s",
    }
)


def _camera_column(*, nullable: bool = False) -> Column[str]:
    return Column("camera", Text, ForeignKey("camera.name"), nullable=nullable)


def _only(condition: str) -> dict[str, Any]:
    """Return the condition of a partial index, for both engines."""
    return {"sqlite_where": text(condition), "postgresql_where": text(condition)}


camera = Table(
    "camera",
    metadata,
    Column("name", Text, primary_key=True),
    Column("latitude", Float, nullable=False),
    Column("longitude", Float, nullable=False),
    Column("altitude", Float, nullable=False),
    Column("width", Integer, nullable=False),
    Column("height", Integer, nullable=False),
    Column("model", Text, nullable=False),
    Column("serial", Text, nullable=False),
    Column("pixel_format", Text, nullable=False, server_default=""),
)

pose_epoch = Table(
    "pose_epoch",
    metadata,
    Column("id", Text, primary_key=True),
    _camera_column(),
    Column("started_at", UtcTime, nullable=False),
    Column("ended_at", UtcTime),
    Column("reason", Text, nullable=False),
    UniqueConstraint("camera", "started_at"),
)

sun_point = Table(
    "sun_point",
    metadata,
    Column("id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    _camera_column(),
    Column("pose_epoch", Text, ForeignKey("pose_epoch.id"), nullable=False),
    Column("time", UtcTime, nullable=False),
    Column("body", Text, nullable=False),
    Column("exposure_us", Number, nullable=False),
    Column("method", Text, nullable=False),
    Column("accepted", Boolean, nullable=False),
    Column("verdict", Text, nullable=False),
    Column("reason", FindingText, key="findings", nullable=False),
    *(
        Column(name, Number)
        for name in (
            "x_px",
            "y_px",
            "sigma_px",
            "peak_fraction",
            "background_fraction",
            "radius_px",
            "ellipticity",
            "residual_chi2",
            "snr",
        )
    ),
    Column("saturated_px", Integer),
    Column("clock_error_s", Number),
    Column("temperature_c", Number),
    Column("pressure_hpa", Number),
    Column("file", Text, nullable=False, server_default=""),
    Column("ingest_pass", Integer),
    Column("folder", Text, nullable=False, server_default=""),
    UniqueConstraint("camera", "time", "body", "exposure_us", "method", "file", "folder"),
)

day = Table(
    "day",
    metadata,
    Column("camera", Text, ForeignKey("camera.name"), primary_key=True),
    Column("date", CalendarDate, primary_key=True),
    Column("verdict", Word(get_args(DayVerdict)), nullable=False),
    Column("reasons", FindingTuple, key="findings", nullable=False),
    Column("n", Integer, nullable=False),
    Column("n_possible", Integer, nullable=False),
    Column("decided_at", UtcTime, nullable=False),
    Column("arc_deg", Float),
    Column("sd_px", Float),
    Column("rmsd_px", Float),
    Column("n_cycles", Integer),
    Column("n_observed", Integer),
    Column("solid_angle_sr", Float),
    Column("doubtful_clock", Float),
    Column("pose_offset_deg", NumberTuple(3)),
    Column("pose_offset_sigma_deg", NumberTuple(3)),
)

night = Table(
    "night",
    metadata,
    Column("camera", Text, ForeignKey("camera.name"), primary_key=True),
    Column("date", CalendarDate, primary_key=True),
    Column("verdict", Word(get_args(NightVerdict)), nullable=False),
    Column("findings", FindingTuple, nullable=False),
    Column("decided_at", UtcTime, nullable=False),
    *(
        Column(name, Count, nullable=False)
        for name in (
            *("n_images", "n_accepted", "n_stored", "n_moon_images", "n_moon_stored"),
            *("n_warm_pixels", "n_stars", "n_matched"),
        )
    ),
    *(
        Column(name, Number)
        for name in (
            *("star_offset_px", "limiting_magnitude", "star_fwhm_px", "cloud_fraction", "transparency", "extinction"),
            *("extinction_sigma", "zero_point", "star_ellipticity", "halo", "width_growth", "halo_growth"),
            "fading_mag",
        )
    ),
    Column("zenith_bands", JsonOf(tuple[NightBand, ...]), nullable=False),
    Column("images", JsonOf(NightSeries)),
    Column("picture_time", UtcTime),
)

day_air = Table(
    "day_air",
    metadata,
    Column("camera", Text, ForeignKey("camera.name"), primary_key=True),
    Column("date", CalendarDate, primary_key=True),
    Column("temperature_c", Float),
    Column("pressure_hpa", Float),
    Column("set_at", UtcTime, nullable=False),
)

calibration = Table(
    "calibration",
    metadata,
    Column("id", Text, primary_key=True),
    _camera_column(),
    Column("state", Word(get_args(CalibrationState)), nullable=False),
    Column("method", Text, nullable=False),
    Column("created_at", UtcTime, nullable=False),
    Column("valid_from", UtcTime, nullable=False),
    Column("valid_until", UtcTime),
    Column("pose_epoch", Text, ForeignKey("pose_epoch.id")),
    Column("parent", Text, ForeignKey("calibration.id")),
    Column("accepted", Boolean, nullable=False),
    Column("reasons", FindingTuple, key="findings", nullable=False),
    Column("document", JSON, nullable=False),
    Column("document_sha256", Text, nullable=False, server_default=""),
    Column("pinned", Boolean, nullable=False, server_default=false()),
    Index("ix_calibration_camera_valid_from", "camera", "valid_from"),
    Index("uq_calibration_one_current", "camera", unique=True, **_only("state = 'current'")),
)

used_sightings = Table(
    "used_sightings",
    metadata,
    Column("calibration", Text, ForeignKey("calibration.id"), primary_key=True),
    Column("ids", LargeBinary, nullable=False),
    Column("epochs", JSON, nullable=False),
    Column("digest", Text, nullable=False),
    Column("air", LargeBinary),
    Column("sigma", LargeBinary),
)

refit = Table(
    "refit",
    metadata,
    Column("id", Text, primary_key=True),
    _camera_column(),
    Column("requested_at", UtcTime, nullable=False),
    Column("reason", Text, nullable=False),
    Column("state", Word(get_args(RefitState)), nullable=False),
    Column("started_at", UtcTime),
    Column("finished_at", UtcTime),
    Column("calibration", Text, ForeignKey("calibration.id")),
    Column("message", Text, nullable=False),
    Column("findings", FindingTuple),
    Index("ix_refit_camera_requested_at", "camera", "requested_at"),
    Index("ix_refit_unfinished", "camera", "requested_at", **_only("finished_at IS NULL")),
)

event = Table(
    "event",
    metadata,
    Column("id", Integer, primary_key=True),
    _camera_column(nullable=True),
    Column("time", UtcTime, nullable=False),
    Column("kind", Text, nullable=False),
    Column("severity", Word(get_args(EventSeverity)), nullable=False),
    Column("text", Text, nullable=False),
    Column("details", JsonObject, nullable=False),
    Index("ix_event_time", "time"),
)

outbox = Table(
    "outbox",
    metadata,
    Column("seq", Integer, primary_key=True),
    Column("kind", Text, nullable=False),
    Column("data", Text, nullable=False),
    sqlite_autoincrement=True,
)

outbox_position = Table(
    "outbox_position",
    metadata,
    Column("installation", Text, primary_key=True),
    Column("committed", BigInteger, nullable=False),
    Column("sent", BigInteger, nullable=False),
)

feed_token = Table(
    "feed_token",
    metadata,
    Column("digest", Text, primary_key=True),
    Column("camera", Text, nullable=False),
    Column("created_at", UtcTime, nullable=False),
    Column("expires_at", UtcTime),
)

feed = Table(
    "feed",
    metadata,
    Column("camera", Text, primary_key=True),
    Column("installation", Text, primary_key=True),
    Column("committed", BigInteger, nullable=False),
    Column("accepted", Boolean, nullable=False),
    Column("first_at", UtcTime, nullable=False),
    Column("last_at", UtcTime, nullable=False),
)

quarantine = Table(
    "quarantine",
    metadata,
    Column("camera", Text, primary_key=True),
    Column("installation", Text, primary_key=True),
    Column("reason", Text, primary_key=True),
    Column("seq", BigInteger, primary_key=True, autoincrement=False),
    Column("kind", Text, nullable=False),
    Column("text", Text, nullable=False),
    Column("data", Text, nullable=False),
    Column("n", Integer, nullable=False),
    Column("first_at", UtcTime, nullable=False),
    Column("last_at", UtcTime, nullable=False),
    Index("ix_quarantine_last_at", "last_at"),
)

fleet = Table(
    "fleet",
    metadata,
    Column("camera", Text, primary_key=True),
    Column("received_at", UtcTime, nullable=False),
    Column("last_sighting_at", UtcTime),
    Column("calibration", Text),
    Column("calibrated_at", UtcTime),
    Column("sky_rms_deg", Float),
    Column("status", JsonObject, nullable=False),
    Column("status_at", UtcTime),
)

notice = Table(
    "notice",
    metadata,
    Column("seq", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("id", Text, nullable=False),
    Column("camera", Text, nullable=False),
    Column("time", UtcTime, nullable=False),
    Column("kind", Text, nullable=False),
    Column("data", JsonObject, nullable=False),
    sqlite_autoincrement=True,
)

notice_position = Table(
    "notice_position",
    metadata,
    Column("camera", Text, primary_key=True),
    Column("event", BigInteger, nullable=False),
    Column("calibration", Text, nullable=False),
    Column("conditions", JsonObject, nullable=False),
    Column("since", UtcTime, nullable=False),
)

notice_sink = Table(
    "notice_sink",
    metadata,
    Column("sink", Text, primary_key=True),
    Column("seq", BigInteger, nullable=False),
    Column("refused", Integer, nullable=False),
)

day_summary = Table(
    "day_summary",
    metadata,
    Column("camera", Text, ForeignKey("camera.name"), primary_key=True),
    Column("date", CalendarDate, primary_key=True),
    Column("verdict", Text, nullable=False),
    Column("n_sightings", Integer, nullable=False),
    Column("n_accepted", Integer, nullable=False),
    Column("clock_error_s", Number),
    Column("temperature_c", Number),
    Column("n_warnings", Integer, nullable=False),
    Column("calibration", Text),
    Column("sky_rms_deg", Number),
    Column("pose_offset_deg", Number),
    Column("decided_at", UtcTime, nullable=False),
)

nightly_run = Table(
    "nightly_run",
    metadata,
    Column("night", CalendarDate, primary_key=True),
    Column("started_at", UtcTime, nullable=False),
    Column("finished_at", UtcTime),
    Column("results", JsonObject, nullable=False),
)

housekeeping = Table(
    "housekeeping",
    metadata,
    Column("camera", Text, primary_key=True),  # no reference: disks fill before a camera has answered
    Column("step", Word(get_args(HousekeepingStep)), primary_key=True),
    Column("time", UtcTime, primary_key=True),
    *(Column(name, BigInteger) for name in ("disk_free_bytes", "images_bytes")),
    *(Column(name, Number) for name in ("temperature_c", "temperature_min_c", "temperature_max_c")),
    Column("n_temperatures", Integer, nullable=False),
)

night_image = Table(
    "night_image",
    metadata,
    Column("camera", Text, primary_key=True),  # no reference: a full disk may have refused the camera's own row
    Column("time", UtcTime, primary_key=True),
    Column("kind", Word(("stars", "moon")), primary_key=True),
    *(Column(name, Number, nullable=False) for name in ("exposure_us", "gain_db")),
    Column("pixel_format", Text, nullable=False),
    *(Column(name, Integer, nullable=False) for name in ("full_scale", "width", "height", "binning")),
    Column("serial", Text, nullable=False),
    Column("clock_error_s", Number, nullable=False),
    Column("halo", Number),
    Column("digest", BigInteger, nullable=False),
    *(Column(name, Integer, nullable=False) for name in ("n_repeated", "n_tries")),
    Column("measured", LargeBinary, nullable=False),
    Column("picture", LargeBinary),
)

seen_file = Table(
    "seen_file",
    metadata,
    Column("camera", Text, primary_key=True),  # no reference: files are seen before an image shows the camera's size
    Column("file", Text, primary_key=True),
    Column("stamp", Text, nullable=False),
    Column("content", Text),
    Column("time", UtcTime),
    Column("code", Text),
    Index("ix_seen_file_time", "camera", "time"),
)

condition = Table(
    "condition",
    metadata,
    Column("camera", Text, primary_key=True),
    Column("code", Text, primary_key=True),
    Column("since", UtcTime, nullable=False),
)
