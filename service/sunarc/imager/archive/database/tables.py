"""The tables of the head revision, and the types of their columns; a column carries the name of the value's field.

A stored value that cannot be read (a flipped bit, a hand) is None, and never an exception. A row that lacks a value
which it must have is then left out of what is returned (see `store.read_records`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from datetime import date, datetime
from typing import Any, get_args

import sqlalchemy as sa
from pydantic import TypeAdapter, ValidationError
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.sql.functions import GenericFunction

from sunarc.common.findings import Finding, from_json
from sunarc.common.utc import from_microseconds, to_microseconds
from sunarc.imager.archive import values
from sunarc.imager.archive.database.connections import parsed_json


class UtcTime(sa.TypeDecorator[datetime]):
    """An aware UTC time as whole microseconds since 1970, so that equality and order are exact."""

    impl = sa.BigInteger
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: sa.Dialect) -> int | None:  # noqa: ARG002 - SQLAlchemy's
        """Return the number to store."""
        return None if value is None else to_microseconds(value)

    def process_result_value(self, value: Any | None, dialect: sa.Dialect) -> datetime | None:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored time, aware."""
        if not isinstance(value, int):
            return None
        try:
            return from_microseconds(value)
        except OverflowError:  # no year that a datetime can hold
            return None


class Number(sa.TypeDecorator[float]):
    """Column of numbers; a text in place of a number is read as None, and NaN as well, which SQLite stores as NULL."""

    impl = sa.Float
    cache_ok = True

    def process_bind_param(self, value: float | None, dialect: sa.Dialect) -> float | None:  # noqa: ARG002 - SQLAlchemy's
        """Return the number to store."""
        return None if value is None or math.isnan(value) else value

    def process_result_value(self, value: Any | None, dialect: sa.Dialect) -> float | None:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored number."""
        return value if isinstance(value, int | float) else None


class Count(sa.TypeDecorator[int]):
    """Column of whole numbers; another stored value is read as None."""

    impl = sa.Integer
    cache_ok = True

    def process_result_value(self, value: Any | None, dialect: sa.Dialect) -> int | None:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored number."""
        return value if isinstance(value, int) else None


class CalendarDate(sa.TypeDecorator[date]):
    """Column of dates, stored as SQLAlchemy's `Date` does: ISO 8601 text in SQLite."""

    impl = sa.Date
    cache_ok = True

    def result_processor(self, dialect: sa.Dialect, coltype: object) -> Callable[[Any], date | None]:  # noqa: ARG002 - SQLAlchemy's
        """Return the reader of the stored text."""
        return _parse_date


class Word(sa.TypeDecorator[str]):
    """Column of one word of a few; another stored value is read as None."""

    impl = sa.Text
    cache_ok = True

    def __init__(self, words: tuple[str, ...]) -> None:
        super().__init__()
        self.words = words

    def process_result_value(self, value: Any | None, dialect: sa.Dialect) -> str | None:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored word."""
        return value if value in self.words else None


class FindingTuple(sa.TypeDecorator[tuple[Finding, ...]]):
    """Column of findings, stored as a JSON list of objects; sentences of version 0.2 become findings without a code."""

    impl = sa.JSON
    cache_ok = True

    def process_bind_param(self, value: tuple[Finding, ...] | None, dialect: sa.Dialect) -> list[dict[str, Any]]:  # noqa: ARG002 - SQLAlchemy's
        """Return the list to store."""
        return [finding.as_json() for finding in value or ()]

    def process_result_value(self, value: Any | None, dialect: sa.Dialect) -> tuple[Finding, ...]:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored findings; empty where they cannot be read."""
        return tuple(from_json(one) for one in value) if isinstance(value, list) else ()


class FindingText(sa.TypeDecorator[tuple[Finding, ...]]):
    """Findings, as the text of a JSON list, empty without any; a sentence of revision 0017 and before is `uncoded`."""

    impl = sa.Text
    cache_ok = True

    def process_bind_param(self, value: tuple[Finding, ...] | None, dialect: sa.Dialect) -> str:  # noqa: ARG002 - SQLAlchemy's
        """Return the text to store; equal findings have equal texts."""
        return json.dumps([one.as_json() for one in value], separators=(",", ":")) if value else ""

    def process_result_value(self, value: Any | None, dialect: sa.Dialect) -> tuple[Finding, ...]:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored findings."""
        return parse_finding_text(value)


def parse_finding_text(text: Any | None) -> tuple[Finding, ...]:  # noqa: ANN401 - whatever is stored
    """Return the findings of a text of `FindingText`, or of a sentence."""
    stored = parsed_json(str(text)) if str(text).startswith("[{") else [text] if text else []
    return tuple(from_json(one) for one in (stored if isinstance(stored, list) else [text]))


class NumberTuple(sa.TypeDecorator[tuple[float, ...]]):
    """Column of a fixed number of numbers, stored as a JSON list; None without them."""

    impl = sa.JSON(none_as_null=True)
    cache_ok = True

    def __init__(self, length: int) -> None:
        super().__init__()
        self.length = length

    def process_bind_param(self, value: tuple[float, ...] | None, dialect: sa.Dialect) -> list[float] | None:  # noqa: ARG002 - SQLAlchemy's
        """Return the list to store."""
        return None if value is None else list(value)

    def process_result_value(self, value: Any | None, dialect: sa.Dialect) -> tuple[float, ...] | None:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored numbers."""
        if not isinstance(value, list) or len(value) != self.length:
            return None
        return tuple(value) if all(isinstance(number, int | float) for number in value) else None


class JsonOf(sa.TypeDecorator[Any]):
    """Column of values of one type, stored as JSON; None where the stored JSON does not hold such a value.

    Parameters
    ----------
    kind : the type, as pydantic reads and writes it.
    """

    impl = sa.JSON(none_as_null=True)
    cache_ok = True

    def __init__(self, kind: type[Any]) -> None:
        super().__init__()
        self.kind = kind
        self._adapter: TypeAdapter[Any] = TypeAdapter(kind)

    def process_bind_param(self, value: Any | None, dialect: sa.Dialect) -> Any:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the JSON to store."""
        return None if value is None else self._adapter.dump_python(value, mode="json")

    def process_result_value(self, value: Any | None, dialect: sa.Dialect) -> Any:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored value."""
        try:
            return None if value is None else self.read(value)
        except ValidationError:
            return None

    def read(self, value: object) -> Any:  # noqa: ANN401 - of the type
        """Return the value of JSON; pydantic's `ValidationError`, which is a `ValueError`, for an invalid one."""
        return self._adapter.validate_python(value)

    def schema(self) -> dict[str, Any]:
        """Return the JSON Schema of the value."""
        return self._adapter.json_schema()


class JsonObject(sa.TypeDecorator[dict[str, Any]]):
    """Column of JSON objects; empty where the stored value cannot be read."""

    impl = sa.JSON
    cache_ok = True

    def process_result_value(self, value: Any | None, dialect: sa.Dialect) -> dict[str, Any]:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored object."""
        return value if isinstance(value, dict) else {}


def stored_bytes(column: sa.ColumnElement[Any]) -> sa.ColumnElement[bytes]:
    """Return the bytes of a JSON column as they are stored."""
    return _StoredBytes(column)


class _StoredBytes(GenericFunction[bytes]):
    type = sa.LargeBinary()
    inherit_cache = True


@compiles(_StoredBytes)
def _cast_to_blob(element: _StoredBytes, compiler: SQLCompiler, **options: Any) -> str:  # noqa: ANN401 - SQLAlchemy's
    return f"CAST({compiler.process(element.clauses, **options)} AS BLOB)"


@compiles(_StoredBytes, "postgresql")
def _convert_to_bytes(element: _StoredBytes, compiler: SQLCompiler, **options: Any) -> str:  # noqa: ANN401 - SQLAlchemy's
    return f"convert_to(({compiler.process(element.clauses, **options)})::text, 'UTF8')"


class stored_as(GenericFunction[bool]):  # noqa: N801 - a function of SQL
    """Whether a column's value is stored as SQLite's `kind`; on PostgreSQL: whether it is present."""

    type = sa.Boolean()
    inherit_cache = True


@compiles(stored_as)
def _compare_type(element: stored_as, compiler: SQLCompiler, **options: Any) -> str:  # noqa: ANN401 - SQLAlchemy's
    column, kind = element.clauses
    return f"(typeof({compiler.process(column, **options)}) = {compiler.process(kind, **options)})"


class is_number(GenericFunction[bool]):  # noqa: N801 - a function of SQL
    """Whether a column's value is a number; on PostgreSQL: whether it is present."""

    type = sa.Boolean()
    inherit_cache = True


@compiles(is_number)
def _compare_order(element: is_number, compiler: SQLCompiler, **options: Any) -> str:  # noqa: ANN401 - SQLAlchemy's
    # texts and blobs come after all numbers; millions of names of types would take twice as long to compare
    return f"({compiler.process(next(iter(element.clauses)), **options)} <= 9e999)"


@compiles(stored_as, "postgresql")
@compiles(is_number, "postgresql")
def _compare_null(element: stored_as | is_number, compiler: SQLCompiler, **options: Any) -> str:  # noqa: ANN401 - SQLAlchemy's
    return f"({compiler.process(next(iter(element.clauses)), **options)} IS NOT NULL)"


def _parse_date(stored: object) -> date | None:
    if isinstance(stored, date):
        return stored
    try:
        return date.fromisoformat(stored) if isinstance(stored, str) else None
    except ValueError:
        return None


metadata = sa.MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s",
        "pk": "pk_%(table_name)s",
    }
)


def columns(kind: Any, names: str, **options: Any) -> list[sa.Column[Any]]:  # noqa: ANN401 - of SQLAlchemy
    """Return columns of one type with the same options; `names` has spaces between them."""
    return [sa.Column(name, kind, **options) for name in names.split()]


def _camera_column(*, nullable: bool = False) -> sa.Column[str]:
    return sa.Column("camera", sa.Text, sa.ForeignKey("camera.name"), nullable=nullable)


def _partial_index_options(condition: str) -> dict[str, Any]:
    """Return the condition of a partial index, for both engines."""
    return {"sqlite_where": sa.text(condition), "postgresql_where": sa.text(condition)}


camera = sa.Table(
    "camera",
    metadata,
    sa.Column("name", sa.Text, primary_key=True),
    *columns(sa.Float, "latitude longitude altitude", nullable=False),
    *columns(sa.Integer, "width height", nullable=False),
    *columns(sa.Text, "model serial", nullable=False),
    sa.Column("pixel_format", sa.Text, nullable=False, server_default=""),
)

pose_epoch = sa.Table(
    "pose_epoch",
    metadata,
    sa.Column("id", sa.Text, primary_key=True),
    _camera_column(),
    sa.Column("started_at", UtcTime, nullable=False),
    sa.Column("ended_at", UtcTime),
    sa.Column("reason", sa.Text, nullable=False),
    sa.UniqueConstraint("camera", "started_at"),
)

sun_point = sa.Table(
    "sun_point",
    metadata,
    sa.Column("id", sa.BigInteger().with_variant(sa.Integer, "sqlite"), primary_key=True),
    _camera_column(),
    sa.Column("pose_epoch", sa.Text, sa.ForeignKey("pose_epoch.id"), nullable=False),
    sa.Column("time", UtcTime, nullable=False),
    sa.Column("body", sa.Text, nullable=False),
    sa.Column("exposure_us", Number, nullable=False),
    sa.Column("method", sa.Text, nullable=False),
    sa.Column("accepted", sa.Boolean, nullable=False),
    sa.Column("verdict", sa.Text, nullable=False),
    sa.Column("reason", FindingText, key="findings", nullable=False),
    *columns(Number, "x_px y_px sigma_px peak_fraction background_fraction radius_px ellipticity residual_chi2 snr"),
    sa.Column("saturated_px", sa.Integer),
    *columns(Number, "clock_error_s temperature_c pressure_hpa"),
    sa.Column("file", sa.Text, nullable=False, server_default=""),
    sa.Column("ingest_pass", sa.Integer),
    sa.Column("folder", sa.Text, nullable=False, server_default=""),
    sa.UniqueConstraint("camera", "time", "body", "exposure_us", "method", "file", "folder"),
)

day = sa.Table(
    "day",
    metadata,
    sa.Column("camera", sa.Text, sa.ForeignKey("camera.name"), primary_key=True),
    sa.Column("date", CalendarDate, primary_key=True),
    sa.Column("verdict", Word(get_args(values.DayVerdict)), nullable=False),
    sa.Column("reasons", FindingTuple, key="findings", nullable=False),
    *columns(sa.Integer, "n n_possible", nullable=False),
    sa.Column("decided_at", UtcTime, nullable=False),
    *columns(sa.Float, "arc_deg sd_px rmsd_px"),
    *columns(sa.Integer, "n_cycles n_observed"),
    *columns(sa.Float, "solid_angle_sr doubtful_clock"),
    *columns(NumberTuple(3), "pose_offset_deg pose_offset_sigma_deg"),
)

night = sa.Table(
    "night",
    metadata,
    sa.Column("camera", sa.Text, sa.ForeignKey("camera.name"), primary_key=True),
    sa.Column("date", CalendarDate, primary_key=True),
    sa.Column("verdict", Word(get_args(values.NightVerdict)), nullable=False),
    sa.Column("findings", FindingTuple, nullable=False),
    sa.Column("decided_at", UtcTime, nullable=False),
    *columns(
        Count,
        "n_images n_accepted n_stored n_moon_images n_moon_stored n_warm_pixels n_stars n_matched",
        nullable=False,
    ),
    *columns(
        Number,
        "star_offset_px limiting_magnitude star_fwhm_px cloud_fraction transparency extinction "
        "extinction_sigma zero_point star_ellipticity halo width_growth halo_growth fading_mag",
    ),
    sa.Column("zenith_bands", JsonOf(tuple[values.NightBand, ...]), nullable=False),
    sa.Column("images", JsonOf(values.NightSeries)),
    sa.Column("picture_time", UtcTime),
)

day_air = sa.Table(
    "day_air",
    metadata,
    sa.Column("camera", sa.Text, sa.ForeignKey("camera.name"), primary_key=True),
    sa.Column("date", CalendarDate, primary_key=True),
    *columns(sa.Float, "temperature_c pressure_hpa"),
    sa.Column("set_at", UtcTime, nullable=False),
)

calibration = sa.Table(
    "calibration",
    metadata,
    sa.Column("id", sa.Text, primary_key=True),
    _camera_column(),
    sa.Column("state", Word(get_args(values.CalibrationState)), nullable=False),
    sa.Column("method", sa.Text, nullable=False),
    *columns(UtcTime, "created_at valid_from", nullable=False),
    sa.Column("valid_until", UtcTime),
    sa.Column("pose_epoch", sa.Text, sa.ForeignKey("pose_epoch.id")),
    sa.Column("parent", sa.Text, sa.ForeignKey("calibration.id")),
    sa.Column("accepted", sa.Boolean, nullable=False),
    sa.Column("reasons", FindingTuple, key="findings", nullable=False),
    sa.Column("document", sa.JSON, nullable=False),
    sa.Column("document_sha256", sa.Text, nullable=False, server_default=""),
    sa.Column("pinned", sa.Boolean, nullable=False, server_default=sa.false()),
    sa.Index("ix_calibration_camera_valid_from", "camera", "valid_from"),
    sa.Index("uq_calibration_one_current", "camera", unique=True, **_partial_index_options("state = 'current'")),
)

used_sightings = sa.Table(
    "used_sightings",
    metadata,
    sa.Column("calibration", sa.Text, sa.ForeignKey("calibration.id"), primary_key=True),
    sa.Column("ids", sa.LargeBinary, nullable=False),
    sa.Column("epochs", sa.JSON, nullable=False),
    sa.Column("digest", sa.Text, nullable=False),
    *columns(sa.LargeBinary, "air sigma"),
)

refit = sa.Table(
    "refit",
    metadata,
    sa.Column("id", sa.Text, primary_key=True),
    _camera_column(),
    sa.Column("requested_at", UtcTime, nullable=False),
    sa.Column("reason", sa.Text, nullable=False),
    sa.Column("state", Word(get_args(values.RefitState)), nullable=False),
    *columns(UtcTime, "started_at finished_at"),
    sa.Column("calibration", sa.Text, sa.ForeignKey("calibration.id")),
    sa.Column("message", sa.Text, nullable=False),
    sa.Column("findings", FindingTuple),
    sa.Index("ix_refit_camera_requested_at", "camera", "requested_at"),
    sa.Index("ix_refit_unfinished", "camera", "requested_at", **_partial_index_options("finished_at IS NULL")),
)

event = sa.Table(
    "event",
    metadata,
    sa.Column("id", sa.Integer, primary_key=True),
    _camera_column(nullable=True),
    sa.Column("time", UtcTime, nullable=False),
    sa.Column("kind", sa.Text, nullable=False),
    sa.Column("severity", Word(get_args(values.EventSeverity)), nullable=False),
    sa.Column("text", sa.Text, nullable=False),
    sa.Column("details", JsonObject, nullable=False),
    sa.Index("ix_event_time", "time"),
)

outbox = sa.Table(
    "outbox",
    metadata,
    sa.Column("seq", sa.Integer, primary_key=True),
    *columns(sa.Text, "kind data", nullable=False),
    sqlite_autoincrement=True,
)

outbox_position = sa.Table(
    "outbox_position",
    metadata,
    sa.Column("installation", sa.Text, primary_key=True),
    *columns(sa.BigInteger, "committed sent", nullable=False),
)

feed_token = sa.Table(
    "feed_token",
    metadata,
    sa.Column("digest", sa.Text, primary_key=True),
    sa.Column("camera", sa.Text, nullable=False),
    sa.Column("created_at", UtcTime, nullable=False),
    sa.Column("expires_at", UtcTime),
)

feed = sa.Table(
    "feed",
    metadata,
    *columns(sa.Text, "camera installation", primary_key=True),
    sa.Column("committed", sa.BigInteger, nullable=False),
    sa.Column("accepted", sa.Boolean, nullable=False),
    *columns(UtcTime, "first_at last_at", nullable=False),
)

quarantine = sa.Table(
    "quarantine",
    metadata,
    *columns(sa.Text, "camera installation reason", primary_key=True),
    sa.Column("seq", sa.BigInteger, primary_key=True, autoincrement=False),
    *columns(sa.Text, "kind text data", nullable=False),
    sa.Column("n", sa.Integer, nullable=False),
    *columns(UtcTime, "first_at last_at", nullable=False),
    sa.Index("ix_quarantine_last_at", "last_at"),
)

fleet = sa.Table(
    "fleet",
    metadata,
    sa.Column("camera", sa.Text, primary_key=True),
    sa.Column("received_at", UtcTime, nullable=False),
    sa.Column("last_sighting_at", UtcTime),
    sa.Column("calibration", sa.Text),
    sa.Column("calibrated_at", UtcTime),
    sa.Column("sky_rms_deg", sa.Float),
    sa.Column("status", JsonObject, nullable=False),
    sa.Column("status_at", UtcTime),
)

notice = sa.Table(
    "notice",
    metadata,
    sa.Column("seq", sa.BigInteger().with_variant(sa.Integer, "sqlite"), primary_key=True),
    *columns(sa.Text, "id camera", nullable=False),
    sa.Column("time", UtcTime, nullable=False),
    sa.Column("kind", sa.Text, nullable=False),
    sa.Column("data", JsonObject, nullable=False),
    sqlite_autoincrement=True,
)

notice_position = sa.Table(
    "notice_position",
    metadata,
    sa.Column("camera", sa.Text, primary_key=True),
    sa.Column("event", sa.BigInteger, nullable=False),
    sa.Column("calibration", sa.Text, nullable=False),
    sa.Column("conditions", JsonObject, nullable=False),
    sa.Column("since", UtcTime, nullable=False),
)

notice_sink = sa.Table(
    "notice_sink",
    metadata,
    sa.Column("sink", sa.Text, primary_key=True),
    sa.Column("seq", sa.BigInteger, nullable=False),
    sa.Column("refused", sa.Integer, nullable=False),
)

day_summary = sa.Table(
    "day_summary",
    metadata,
    sa.Column("camera", sa.Text, sa.ForeignKey("camera.name"), primary_key=True),
    sa.Column("date", CalendarDate, primary_key=True),
    sa.Column("verdict", sa.Text, nullable=False),
    *columns(sa.Integer, "n_sightings n_accepted", nullable=False),
    *columns(Number, "clock_error_s temperature_c"),
    sa.Column("n_warnings", sa.Integer, nullable=False),
    sa.Column("calibration", sa.Text),
    *columns(Number, "sky_rms_deg pose_offset_deg"),
    sa.Column("decided_at", UtcTime, nullable=False),
)

nightly_run = sa.Table(
    "nightly_run",
    metadata,
    sa.Column("night", CalendarDate, primary_key=True),
    sa.Column("started_at", UtcTime, nullable=False),
    sa.Column("finished_at", UtcTime),
    sa.Column("results", JsonObject, nullable=False),
)

housekeeping = sa.Table(
    "housekeeping",
    metadata,
    sa.Column("camera", sa.Text, primary_key=True),  # no reference: disks fill before a camera has answered
    sa.Column("step", Word(get_args(values.HousekeepingStep)), primary_key=True),
    sa.Column("time", UtcTime, primary_key=True),
    *columns(sa.BigInteger, "disk_free_bytes images_bytes"),
    *columns(Number, "temperature_c temperature_min_c temperature_max_c"),
    sa.Column("n_temperatures", sa.Integer, nullable=False),
)

night_image = sa.Table(
    "night_image",
    metadata,
    sa.Column("camera", sa.Text, primary_key=True),  # no reference: a full disk may have refused the camera's own row
    sa.Column("time", UtcTime, primary_key=True),
    sa.Column("kind", Word(("stars", "moon")), primary_key=True),
    *columns(Number, "exposure_us gain_db", nullable=False),
    sa.Column("pixel_format", sa.Text, nullable=False),
    *columns(sa.Integer, "full_scale width height binning", nullable=False),
    sa.Column("serial", sa.Text, nullable=False),
    sa.Column("clock_error_s", Number, nullable=False),
    sa.Column("halo", Number),
    sa.Column("digest", sa.BigInteger, nullable=False),
    *columns(sa.Integer, "n_repeated n_tries", nullable=False),
    sa.Column("measured", sa.LargeBinary, nullable=False),
    sa.Column("picture", sa.LargeBinary),
)

seen_file = sa.Table(
    "seen_file",
    metadata,
    sa.Column(
        "camera", sa.Text, primary_key=True
    ),  # no reference: files are seen before an image shows the camera's size
    sa.Column("file", sa.Text, primary_key=True),
    sa.Column("stamp", sa.Text, nullable=False),
    sa.Column("content", sa.Text),
    sa.Column("time", UtcTime),
    sa.Column("code", sa.Text),
    sa.Index("ix_seen_file_time", "camera", "time"),
)

condition = sa.Table(
    "condition",
    metadata,
    *columns(sa.Text, "camera code", primary_key=True),
    sa.Column("since", UtcTime, nullable=False),
)
