"""Requests to an imager, and the readers of the answers."""

from __future__ import annotations

import io
import json
import urllib.parse
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import date, datetime
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .answers import FloatArray, Located
from .transport import ImagerError, Transport

_NPY = "application/x-npy"


class Requests:
    """Base of `Imager` and `Hub` with their common requests."""

    def __init__(
        self,
        address: str,
        *,
        camera: str | None = None,
        calibration: str | None = None,
        token: str | None = None,
        timeout_s: float = 30.0,
        retries: int = 4,
    ) -> None:
        self._transport = Transport(address, token=token, timeout_s=timeout_s, retries=retries)
        self._chosen = calibration
        self._prefix = "/v1" if camera is None else f"/v1/cameras/{urllib.parse.quote(camera, safe='')}"

    def _ask_content(self, path: str, **query: str | None) -> bytes:
        return self._transport.ask(f"{self._prefix}{path}", query)[0]

    def _ask_json(self, path: str, **query: str | None) -> dict[str, Any]:
        content = self._ask_content(path, **query)
        with _require_expected_content():
            return dict(json.loads(content))

    def _ask_service_json(self, path: str) -> dict[str, Any]:
        content, _ = self._transport.ask(path, {})
        with _require_expected_content():
            return dict(json.loads(content))

    def _ask_list(self, path: str, name: str, **query: str | None) -> list[dict[str, Any]]:
        """Return the rows of an answer that has no pages."""
        found = self._ask_json(path, **query)
        with _require_expected_content():
            return list(found[name])

    def _ask_arrays(self, path: str, **query: str | None) -> dict[str, NDArray[Any]]:
        content = self._ask_content(path, format="npz", **query)
        with _require_expected_content(), np.load(io.BytesIO(content), allow_pickle=False) as found:
            return {name: found[name] for name in found.files}

    def _ask_pages(self, path: str, name: str, **query: str | None) -> Iterator[dict[str, Any]]:
        """Yield the rows of all pages."""
        query, path = {**query, "limit": "1000"}, f"{self._prefix}{path}"
        while path:
            content, _ = self._transport.ask(path, query)
            with _require_expected_content():
                page = json.loads(content)
                yield from page[name]
                path, _, text = (page["next"] or "").partition("?")
            query = dict(urllib.parse.parse_qsl(text))

    def _ask_change(self, path: str, *, method: str = "POST", **body: object) -> dict[str, Any]:
        content = self._transport.change(f"{self._prefix}{path}", json.dumps(body).encode(), method=method)
        with _require_expected_content():
            return dict(json.loads(content))

    def _is_answered(self, path: str) -> bool:
        try:
            self._transport.ask(path, {}, again=False)
        except ImagerError:
            return False
        return True

    def _make_grid_query(
        self, grid: str, size: int, height_m: float | None, half_width_m: float | None
    ) -> dict[str, str | None]:
        sizes = {"size": str(size), "height": _format_number(height_m), "half_width": _format_number(half_width_m)}
        return {"grid": grid, **sizes, "calibration": self._chosen}

    def _ask_rows(
        self, path: str, values: ArrayLike, width: int, at: datetime | None, *, draws: int = 0, seed: int = 0
    ) -> tuple[FloatArray, str, tuple[int, ...]]:
        array = np.asarray(values, dtype=np.float64)
        if array.ndim < 1 or array.shape[-1] != width:
            raise ValueError(f"shape {array.shape}: the last dimension has to be {width}")
        stream = io.BytesIO()
        np.save(stream, np.ascontiguousarray(array.reshape(-1, width)), allow_pickle=False)
        query = {"at": _format_time(at), "calibration": self._chosen} | (
            {"draws": str(draws), "seed": str(seed)} if draws else {}
        )
        content, headers = self._transport.ask(f"{self._prefix}{path}", query, body=stream.getvalue(), media_type=_NPY)
        with _require_expected_content():
            rows = np.asarray(np.load(io.BytesIO(content), allow_pickle=False), dtype=np.float64)
            calibration = headers["Sunarc-Calibration"]
            if calibration is None:
                raise ValueError("no header Sunarc-Calibration")
        return rows, calibration, array.shape[:-1]


@contextmanager
def _require_expected_content() -> Iterator[None]:
    """Raise ImagerError where content is of another kind than was asked for, as a proxy's page."""
    try:
        yield
    except (ValueError, LookupError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise ImagerError(f"the answer cannot be read: {error}; check the address", status=200) from None


def _make_point_rows(
    pixels: ArrayLike,
    height_m: ArrayLike,
    height_sigma_m: float,
    *,
    times: datetime | Sequence[datetime] | None = None,
) -> FloatArray:
    """Return pixels with the height of the cloud base that they see, its 1-sigma, and their times, s since 1970.

    (..., 3), (..., 4) where the height has a 1-sigma, (..., 5) where there are times.
    """
    pixel = np.asarray(pixels, dtype=np.float64)
    columns: list[ArrayLike] = [height_m]
    if height_sigma_m or times is not None:
        columns.append(height_sigma_m)
    if times is not None:
        named = [times] if isinstance(times, datetime) else times
        columns.append([_require_aware(time).timestamp() for time in named])
    broadcast = [np.broadcast_to(np.asarray(one, dtype=np.float64), pixel.shape[:-1])[..., None] for one in columns]
    return np.concatenate([pixel, *broadcast], axis=-1)


def _parse_located(rows: FloatArray, shape: tuple[int, ...]) -> Located:
    return Located(
        position_m=rows[:, :3].reshape(*shape, 3),
        latitude=rows[:, 3].reshape(shape),
        longitude=rows[:, 4].reshape(shape),
        altitude=rows[:, 5].reshape(shape),
        sigma_m=rows[:, 6].reshape(shape),
        covariance_m2=rows[:, [7, 8, 8, 9]].reshape(*shape, 2, 2),
    )


def _format_time(at: datetime | None) -> str | None:
    return None if at is None else _require_aware(at).isoformat()


def _require_aware(time: datetime) -> datetime:
    if time.tzinfo is None:
        raise ValueError(f"{time} has no time zone")
    return time


def _format_image_name(time: datetime | str) -> str:
    """Return the time of an image as its name."""
    return time if isinstance(time, str) else _format_time(time) or ""


def _quote_name(name: str) -> str:
    return urllib.parse.quote(name, safe="")


def _format_day(day: date | None) -> str | None:
    return None if day is None else day.isoformat()


def _format_number(value: float | None) -> str | None:
    return None if value is None else repr(float(value))


def _make_detail_query(detail: str) -> str | None:
    """Return the query of a document's detail; an imager of an earlier version knows the whole alone."""
    return None if detail == "whole" else detail
