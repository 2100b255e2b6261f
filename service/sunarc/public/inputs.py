"""Times, numbers and places as a notebook has them, as the library takes them; answers in the shape of the question."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from typing import Any, NamedTuple, TypeVar

import numpy as np

from sunarc.common.array_types import FloatArray, NameArray
from sunarc.common.errors import InputError
from sunarc.common.utc import parse_time

Values = Any
"""A number, an array of any shape or an xarray.DataArray: as it was asked for."""
Times = Any
"""A time or times: numpy datetime64 (UTC), pandas or `datetime` with a time zone, ISO 8601 text with one."""

_PLAIN_UNIT_NS = {"D": 86_400_000_000_000, "h": 3_600_000_000_000, "m": 60_000_000_000, "s": 1_000_000_000}
_UNIT_NS = _PLAIN_UNIT_NS | {"ms": 1_000_000, "us": 1_000, "ns": 1}
_ZONE = "state it: 2013-05-13T18:30:00Z, datetime(..., tzinfo=UTC), or tz_localize('UTC') of pandas"
_TIMES = "give numpy datetime64 (UTC), pandas or datetime with a time zone, or ISO 8601 text with one"
Result = TypeVar("Result")


def data_array(value: object) -> Any | None:  # noqa: ANN401 - xarray's, where it is installed
    """Return a value that is an xarray.DataArray; None where it is something else."""
    xarray = sys.modules.get("xarray")
    return value if xarray is not None and isinstance(value, xarray.DataArray) else None


def unix_seconds(time: Times, *, field: str = "time") -> FloatArray:
    """Return times as seconds since 1970-01-01 UTC, in their shape.

    Parameters
    ----------
    time : numpy datetime64 and xarray are UTC; pandas (any unit) and `datetime` have a time zone, as has ISO 8601 text.
    field : the name of the argument, for errors.

    Raises
    ------
    InputError
        Where a time has no zone, is missing, or is no time.
    """
    array = data_array(time)
    if array is not None:
        time = array.to_numpy()
    elif not isinstance(time, str | datetime) and hasattr(time, "dtype") and hasattr(time, "to_numpy"):
        time = _convert_pandas(time, field=field)
    values = np.asarray(time if hasattr(time, "dtype") else _make_object_array(time))
    if values.dtype.kind == "M":
        return _convert_datetime64(values, field=field)
    if values.dtype.kind not in "OUT":
        raise InputError(field=field, problem=f"{_show_value(time)} is no time", remedy=_TIMES)
    flat = [_convert_one_time(one, _name_element(field, values, n)) for n, one in enumerate(values.ravel().tolist())]
    return np.array(flat, dtype=np.float64).reshape(values.shape)


def _make_object_array(time: object) -> np.ndarray[Any, np.dtype[Any]]:
    """Return a list of any depth, or one time, as an array of objects; datetime64 keep their type."""
    if isinstance(time, np.datetime64):
        return np.asarray(time)
    if isinstance(time, str | datetime) or not isinstance(time, Iterable):
        return np.array(time, dtype=object)
    return np.array(list(time), dtype=object)


def _convert_pandas(time: Any, *, field: str) -> np.ndarray[Any, np.dtype[Any]]:  # noqa: ANN401 - pandas is not required
    """Return the values of a series or an index; those with a time zone as datetime64 in UTC."""
    if getattr(time.dtype, "kind", "O") != "M":
        return np.asarray(time.to_numpy(dtype=object))
    if getattr(time.dtype, "tz", None) is None:
        raise InputError(field=field, problem="has no time zone", remedy=_ZONE)
    utc = getattr(time, "dt", time).tz_convert("UTC")  # a series has its times in `dt`
    return np.asarray(getattr(utc, "dt", utc).tz_localize(None).to_numpy())


def _convert_datetime64(values: np.ndarray[Any, np.dtype[Any]], *, field: str) -> FloatArray:
    """Return the seconds of datetime64 of any unit; whole microseconds give the digits that `datetime` gives."""
    if np.any(np.isnat(values)):
        missing = int(np.argmax(np.isnat(values)))
        raise InputError(
            field=_name_element(field, values, missing), problem="is not a time (NaT)", remedy="leave the row out"
        )
    unit, count = np.datetime_data(values.dtype)
    if unit not in _UNIT_NS:
        raise InputError(field=field, problem=f"datetime64[{unit}] is too coarse or too fine", remedy="use us or ns")
    if unit != "ns" or count != 1:
        return np.asarray(values.astype("datetime64[us]").astype(np.int64) / 1e6)
    microseconds, rest = np.divmod(values.astype(np.int64), 1000)
    return np.asarray(microseconds / 1e6 + rest * 1e-9)


def _convert_one_time(one: object, field: str) -> float:
    """Return the seconds of a text, a `datetime` or a datetime64."""
    if isinstance(one, str):
        return parse_time(one, where=field).timestamp()
    if isinstance(one, datetime):
        if one != one:  # noqa: PLR0124 - pandas' NaT is a datetime that differs from itself
            raise InputError(field=field, problem="is not a time (NaT)", remedy="leave the row out")
        if one.tzinfo is None:
            raise InputError(field=field, problem=f"{one.isoformat(sep=' ')} has no time zone", remedy=_ZONE)
        return one.timestamp()
    if isinstance(one, np.datetime64):
        return float(_convert_datetime64(np.asarray(one), field=field))
    raise InputError(field=field, problem=f"{_show_value(one)} is no time", remedy=_TIMES)


def _name_element(field: str, values: np.ndarray[Any, np.dtype[Any]], number: int) -> str:
    """Return the name of an element of an argument: `x_px[3]`, `x_px[0, 2]`; of a single one the argument's."""
    if values.ndim == 0:
        return field
    place = np.unravel_index(number, values.shape)
    return f"{field}[{', '.join(str(int(one)) for one in place)}]"


def _show_value(value: object) -> str:
    text = repr(value)
    return text if len(text) < 60 else f"{text[:56]} …"


def numbers(value: Values, *, field: str) -> FloatArray:
    """Return finite numbers in their shape.

    Raises
    ------
    InputError
        Where one is NaN, infinite, masked or no number.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", np.exceptions.ComplexWarning)  # an imaginary part is no number of ours
            found = np.ma.filled(np.ma.asanyarray(value).astype(np.float64), np.nan)
    except (TypeError, ValueError, OverflowError, np.exceptions.ComplexWarning):
        raise InputError(field=field, problem=f"{_show_value(value)} is not numeric", remedy="give numbers") from None
    finite = np.isfinite(found)
    if not np.all(finite):
        where = int(np.argmin(finite))
        shown = f"{found.ravel()[where]:g} is not a finite number"
        raise InputError(field=_name_element(field, found, where), problem=shown, remedy="leave it out, or correct it")
    return np.asarray(found)


def number(value: object, *, field: str) -> float:
    """Return one finite number; InputError for several, and for other values."""
    found = numbers(value, field=field)
    if found.ndim != 0:
        raise InputError(field=field, problem=f"has shape {found.shape}", remedy="give one number")
    return float(found)


def texts(value: object, *, field: str) -> NameArray:
    """Return names in their shape; InputError where one is no text."""
    found = np.asarray(value if not hasattr(value, "to_numpy") else value.to_numpy())
    if not all(isinstance(one, str) for one in found.ravel().tolist()):
        raise InputError(field=field, problem=f"{_show_value(value)} is no text", remedy="give names, as 'sun'")
    return found.astype(np.str_)


def check_image_size(value: object) -> tuple[int, int]:
    """Return width and height in px; InputError where they are no size of an image."""
    found = numbers(value, field="image_size")
    if found.shape != (2,) or np.any(found != np.floor(found)) or np.min(found) < 1.0 or np.max(found) > 1e6:
        remedy = "give width and height in px, as (1748, 1748)"
        raise InputError(field="image_size", problem=f"{_show_value(value)} is no size", remedy=remedy)
    return int(found[0]), int(found[1])


class Asked(NamedTuple):
    """Columns of a request as rows, and the shape of its answer.

    rows: (n, k). shape: of each column. like: the DataArray whose dimensions and coordinates the answer gets.
    """

    rows: FloatArray
    shape: tuple[int, ...]
    like: Any = None

    def answer(self, values: np.ndarray[Any, np.dtype[Any]], *more: str, before: tuple[str, ...] = ()) -> Values:
        """Return values (n, ...) in the shape of the question.

        Parameters
        ----------
        values : one row for each of the question's, after the dimensions `before`.
        more : names of the dimensions that follow, in xarray.
        before : names of the dimensions that precede.
        """
        lead, rest = values.shape[: len(before)], values.shape[len(before) + 1 :]
        shaped = values.reshape((*lead, *self.shape, *rest))
        if self.like is None:
            return shaped[()]  # a question of one has one as its answer
        xarray = sys.modules["xarray"]
        return xarray.DataArray(shaped, dims=(*before, *self.like.dims, *more), coords=dict(self.like.coords))


def asked(**columns: Values) -> Asked:
    """Return the columns of a request, broadcast against each other; those of xarray by their dimensions' names.

    Raises
    ------
    InputError
        Where a value is not finite, or the shapes do not fit.
    """
    arrays = [one for one in columns.values() if data_array(one) is not None]
    like = None
    if arrays:
        xarray = sys.modules["xarray"]
        named = [one if data_array(one) is not None else xarray.DataArray(one) for one in columns.values()]
        broadcast = _require_fitting_shapes(columns, lambda: xarray.broadcast(*named))
        like, columns = broadcast[0], dict(zip(columns, broadcast, strict=True))
    found = {name: numbers(one, field=name) for name, one in columns.items()}
    parts = _require_fitting_shapes(found, lambda: np.broadcast_arrays(*found.values()))
    rows = np.stack([part.ravel() for part in parts], axis=-1)
    return Asked(rows, parts[0].shape, like)


def one_time(time: Times, *, remedy: str) -> float:
    """Return one time as seconds since 1970-01-01 UTC; InputError with the remedy where there are several."""
    unix_s = unix_seconds(time)
    if unix_s.ndim != 0:
        raise InputError(field="time", problem=f"has shape {unix_s.shape}", remedy=remedy)
    return float(unix_s)


def asked_times(time: Times) -> Asked:
    """Return times as a request: one column, seconds since 1970-01-01 UTC; see `unix_seconds`."""
    unix_s = unix_seconds(time)
    return Asked(unix_s.reshape(-1, 1), unix_s.shape, data_array(time))


def _require_fitting_shapes(columns: Mapping[str, Values], broadcast: Callable[[], Result]) -> Result:
    """Return the broadcast values; InputError where the shapes do not fit."""
    try:
        return broadcast()
    except ValueError:
        shapes = " and ".join(f"{name} {np.shape(one)}" for name, one in columns.items())
        field = ", ".join(columns)
        raise InputError(field=field, problem=f"shapes differ: {shapes}", remedy="give as many of each") from None


def choice(name: str, value: object, choices: tuple[Any, ...]) -> Any:  # noqa: ANN401 - one of the choices
    """Return a choice; InputError names the valid ones for another."""
    if value in choices:
        return value
    raise InputError(field=name, problem=f"{value!r} is unknown", remedy=f"use one of {', '.join(choices)}")


_OPTIONS = {
    "--format": "format",
    "--start": "start",
    "--pose-only": "pose_only",
    "--lens-within": "lens_within_px",
    "--pose-within": "pose_within_deg",
    "--focal-within": "focal_within",
    "--level-within": "level_within_deg",
    "--clock-error": "clock_error_s",
    "--outwards-px": "outwards_px",
    "--projection": "projection",
    "--mirrored": "mirrored",
    "calibration.": "",
    "image size": "image_size",
    "image circle.": "image_circle.",
}
"""Names of the command's options and their names in Python."""


@contextmanager
def named_as_in_python() -> Iterator[None]:
    """Rename the fields of a command function's errors to the arguments of the Python function."""
    try:
        yield
    except InputError as error:
        said = []
        for text in (error.field, error.problem, error.remedy):
            for option, argument in _OPTIONS.items():
                text = text.replace(option, argument)  # noqa: PLW2901 - each replaces a part
            said.append(text)
        raise InputError(field=said[0], problem=said[1], remedy=said[2]) from None
