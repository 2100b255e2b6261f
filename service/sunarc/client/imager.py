"""What can be asked of an imager: directions of pixels, pixels of directions, clouds and shadows, the map, the sun."""

from __future__ import annotations

import io
import json
import urllib.parse
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sunarc.client.events import ImagerEvent, parsed
from sunarc.client.transport import ImagerError, Transport

FloatArray = NDArray[np.float64]

_NPY = "application/x-npy"


class BackProjection(NamedTuple):
    """What pixels look at; NaN outside the camera's field.

    zenith_deg, azimuth_deg : (...) degrees, azimuth clockwise from north.
    direction : (..., 3) unit vectors, east-north-up.
    sigma_deg : (...) 1-sigma per axis on the sphere.
    inside : (...) within the image and the field.
    calibration : id of the calibration that answered.
    """

    zenith_deg: FloatArray
    azimuth_deg: FloatArray
    direction: FloatArray
    sigma_deg: FloatArray
    inside: NDArray[np.bool_]
    calibration: str


class Projection(NamedTuple):
    """Where directions land; NaN beyond the camera's field.

    pixels : (..., 2) x and y in px.
    sigma_px : (...) 1-sigma per axis.
    covariance_px2 : (..., 2, 2).
    inside : (...) within the image and the field.
    calibration : id of the calibration that answered.
    """

    pixels: FloatArray
    sigma_px: FloatArray
    covariance_px2: FloatArray
    inside: NDArray[np.bool_]
    calibration: str


class Located(NamedTuple):
    """Where clouds, or their shadows, are; NaN where there is no place.

    position_m : (..., 3) metres east, north and up of the camera.
    latitude, longitude, altitude : (...) degrees and metres.
    sigma_m : (...) 1-sigma per axis on the ground, by the calibration and the height.
    covariance_m2 : (..., 2, 2) of east and north.
    """

    position_m: FloatArray
    latitude: FloatArray
    longitude: FloatArray
    altitude: FloatArray
    sigma_m: FloatArray
    covariance_m2: FloatArray


class Finding(NamedTuple):
    """What was found: a code of docs/codes.md, its numbers and names, and the sentence, which is for people only."""

    code: str
    data: dict[str, Any]
    text: str


class Condition(NamedTuple):
    """Why the service is degraded or not ready.

    code : of docs/codes.md; of a worker's condition it ends with the worker's name.
    severity : "degraded" or "not_ready".
    data : its numbers and names.
    text, remedy : the sentence, and what to do ("none": nothing).
    since : since when; None where the service does not say.
    """

    code: str
    severity: str
    data: dict[str, Any]
    text: str
    remedy: str
    since: datetime | None = None


class Imager:
    """An imager's service. Times are aware datetimes; without one, the answer is for now.

    Parameters
    ----------
    address : as "http://imager:8080".
    camera : of several in one store; the service's own unless given.
    token : where reading needs one.
    timeout_s : of one request.
    retries : how often a request is asked again after 429, 503 or no connection, waiting longer each time.
    """

    def __init__(
        self,
        address: str,
        *,
        camera: str | None = None,
        token: str | None = None,
        timeout_s: float = 30.0,
        retries: int = 4,
    ) -> None:
        self._transport = Transport(address, token=token, timeout_s=timeout_s, retries=retries)
        self._prefix = "/v1" if camera is None else f"/v1/cameras/{urllib.parse.quote(camera, safe='')}"

    def back_project(self, pixels: ArrayLike, *, at: datetime | None = None) -> BackProjection:
        """Return what pixels (..., 2) look at."""
        rows, calibration, shape = self._rows("/back-project", pixels, 2, at)
        zenith, azimuth, east, north, up, sigma, inside = np.moveaxis(rows, -1, 0)
        direction = np.stack([east, north, up], axis=-1).reshape(*shape, 3)
        columns = (column.reshape(shape) for column in (zenith, azimuth, sigma, inside == 1.0))
        first, second, third, fourth = columns
        return BackProjection(first, second, direction, third, fourth, calibration)

    def project(self, direction: ArrayLike, *, at: datetime | None = None) -> Projection:
        """Return where vectors (..., 3), east-north-up, of any length but 0, land."""
        rows, calibration, shape = self._rows("/project", direction, 3, at)
        return Projection(
            pixels=rows[:, :2].reshape(*shape, 2),
            sigma_px=rows[:, 2].reshape(shape),
            covariance_px2=rows[:, [3, 4, 4, 5]].reshape(*shape, 2, 2),
            inside=(rows[:, 6] == 1.0).reshape(shape),
            calibration=calibration,
        )

    def back_project_draws(
        self, pixels: ArrayLike, *, draws: int, seed: int = 0, at: datetime | None = None
    ) -> FloatArray:
        """Return unit vectors (draws, ..., 3) of pixels (..., 2), by draws of an ensemble of possible truths.

        The id of the calibration and the seed decide the draws: errors that are common to all pixels are the same in
        every question.
        """
        rows, _, shape = self._rows("/back-project", pixels, 2, at, draws=draws, seed=seed)
        return rows[..., 2:5].reshape(draws, *shape, 3)

    def project_draws(
        self, direction: ArrayLike, *, draws: int, seed: int = 0, at: datetime | None = None
    ) -> FloatArray:
        """Return pixels (draws, ..., 2) of vectors (..., 3), by the draws of `back_project_draws`."""
        rows, _, shape = self._rows("/project", direction, 3, at, draws=draws, seed=seed)
        return rows.reshape(draws, *shape, 2)

    def geolocate(
        self, pixels: ArrayLike, *, height_m: ArrayLike, height_sigma_m: float = 0.0, at: datetime | None = None
    ) -> tuple[Located, Located]:
        """Return where clouds are that pixels (..., 2) see, and where their shadows are.

        Parameters
        ----------
        pixels : (..., 2) px.
        height_m : (...) or one: of the cloud base above the camera's altitude.
        height_sigma_m : 1-sigma of the height.
        at : gives the calibration and the sun.
        """
        points = _points(pixels, height_m, height_sigma_m)
        rows, _, shape = self._rows("/geolocate", points, points.shape[-1], at)
        return _located(rows[:, :10], shape), _located(rows[:, 10:], shape)

    def geolocate_draws(
        self,
        pixels: ArrayLike,
        *,
        height_m: ArrayLike,
        height_sigma_m: float = 0.0,
        draws: int,
        seed: int = 0,
        at: datetime | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the clouds' and the shadows' positions (draws, ..., 3): metres east, north and up of the camera.

        A draw has one error of the calibration and one of the height for all pixels; `seed` as in `back_project_draws`.
        """
        points = _points(pixels, height_m, height_sigma_m)
        rows, _, shape = self._rows("/geolocate", points, points.shape[-1], at, draws=draws, seed=seed)
        return rows[..., :3].reshape(draws, *shape, 3), rows[..., 6:9].reshape(draws, *shape, 3)

    def calibration(self, *, at: datetime | None = None) -> dict[str, Any]:
        """Return the calibration document."""
        return self._json("/calibration", at)

    def export(self, form: str, *, at: datetime | None = None) -> bytes:
        """Return the calibration as a file: opencv, ocamcalib, asi-core (a zip), mrcal, netcdf or npz."""
        return self._transport.ask(f"{self._prefix}/calibration", {"format": form, "at": _time(at)})[0]

    def map(self, *, at: datetime | None = None, sun_radius_deg: float | None = None) -> dict[str, NDArray[Any]]:
        """Return what every pixel sees: zenith, azimuth, direction, sigma and others, by name, (height, width, ...)."""
        radius = None if sun_radius_deg is None else repr(float(sun_radius_deg))
        query = {"format": "npz", "at": _time(at), "sun_radius_deg": radius}
        content, _ = self._transport.ask(f"{self._prefix}/back-projection-map", query)
        with _expected_content(), np.load(io.BytesIO(content), allow_pickle=False) as found:
            return {name: found[name] for name in found.files}

    def images(self, *, since: datetime | None = None, until: datetime | None = None) -> Iterator[dict[str, Any]]:
        """Yield the kept composites with since <= time < until, the newest first: time, calibration and bytes."""
        query = {"since": _time(since), "until": _time(until), "limit": "1000"}
        path = f"{self._prefix}/images"
        while path:
            content, _ = self._transport.ask(path, query)
            with _expected_content():
                page = json.loads(content)
                yield from page["images"]
                path, _, text = (page["next"] or "").partition("?")
            query = dict(urllib.parse.parse_qsl(text))

    def image(self, time: datetime | str, *, form: str = "png") -> bytes:
        """Return a composite: png (16 bit linear counts with metadata) or jpeg, by a time that `images` has."""
        text = time if isinstance(time, str) else _time(time) or ""
        return self._transport.ask(f"{self._prefix}/images/{urllib.parse.quote(text)}", {"format": form})[0]

    def sun(self, *, at: datetime | None = None) -> dict[str, Any]:
        """Return where the sun is, and on which pixel."""
        return self._json("/sun", at)

    def conditions(self) -> tuple[Condition, ...]:
        """Return why the service is degraded or not ready; empty when it is ready. Select by code."""
        content, _ = self._transport.ask("/v1/status", {})
        with _expected_content():
            status = dict(json.loads(content))
            findings = status.get("findings", ())  # version 0.2 has the reasons alone
            data = {finding["code"]: finding["data"] for finding in findings}
            return tuple(
                Condition(
                    one["code"],
                    one["severity"],
                    data.get(one["code"], {}),
                    one["text"],
                    one["remedy"],
                    datetime.fromisoformat(one["since"]) if one.get("since") else None,
                )
                for one in status["reasons"]
            )

    def events(self, *, after: str | None = None, silent_s: float = 60.0) -> Iterator[ImagerEvent]:
        """Yield what happens, for as long as it is iterated over; first a "state" that says how things are.

        A connection that ends, or on which nothing came for `silent_s` (the service gives a sign every 15 s), is made
        again, and goes on where it ended; ImagerError where that fails as often as `retries` says.

        Parameters
        ----------
        after : id of an event received before: those after it are yielded.
        """
        attempt = 0
        while True:
            headers = {} if after is None else {"Last-Event-ID": after}
            try:
                with _expected_content():
                    path = f"{self._prefix}/events/stream"
                    for event in parsed(self._transport.lines(path, headers=headers, silent_s=silent_s)):
                        attempt, after = 0, event.id
                        yield event
                ended = ImagerError("the stream of events ended", status=None)
            except ImagerError as error:
                ended = error
            self._transport.wait(ended, attempt)
            attempt += 1

    def verdict(self, *, at: datetime | None = None) -> tuple[Finding, ...]:
        """Return the findings of the calibration's verdict. Select by code."""
        document = self.calibration(at=at)
        with _expected_content():
            verdict = document["verdict"]
            uncoded = [{"code": "uncoded", "data": {"text": text}} for text in verdict["reasons"]]  # version 0.2
            pairs = zip(verdict.get("findings", uncoded), verdict["reasons"], strict=True)
            return tuple(Finding(finding["code"], finding["data"], text) for finding, text in pairs)

    def _json(self, path: str, at: datetime | None) -> dict[str, Any]:
        content, _ = self._transport.ask(f"{self._prefix}{path}", {"at": _time(at)})
        with _expected_content():
            columns: dict[str, Any] = json.loads(content)
        return columns

    def _rows(
        self, path: str, values: ArrayLike, width: int, at: datetime | None, *, draws: int = 0, seed: int = 0
    ) -> tuple[FloatArray, str, tuple[int, ...]]:
        array = np.asarray(values, dtype=np.float64)
        if array.ndim < 1 or array.shape[-1] != width:
            raise ValueError(f"shape {array.shape}: the last dimension has to be {width}")
        stream = io.BytesIO()
        np.save(stream, np.ascontiguousarray(array.reshape(-1, width)), allow_pickle=False)
        query = {"at": _time(at)} | ({"draws": str(draws), "seed": str(seed)} if draws else {})
        content, headers = self._transport.ask(f"{self._prefix}{path}", query, body=stream.getvalue(), media_type=_NPY)
        with _expected_content():
            rows = np.asarray(np.load(io.BytesIO(content), allow_pickle=False), dtype=np.float64)
            calibration = headers["Sunarc-Calibration"]
            if calibration is None:
                raise ValueError("no header Sunarc-Calibration")
        return rows, calibration, array.shape[:-1]


@contextmanager
def _expected_content() -> Iterator[None]:
    """Raise ImagerError where content is of another kind than was asked for, as a proxy's page."""
    try:
        yield
    except (ValueError, LookupError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise ImagerError(f"the answer cannot be read: {error}; check the address", status=200) from None


def _points(pixels: ArrayLike, height_m: ArrayLike, height_sigma_m: float) -> FloatArray:
    """Return (..., 3): pixels with the height of the cloud base that they see; (..., 4) where it has a 1-sigma."""
    pixel = np.asarray(pixels, dtype=np.float64)
    columns = (height_m, height_sigma_m) if height_sigma_m else (height_m,)
    broadcast = [np.broadcast_to(np.asarray(one, dtype=np.float64), pixel.shape[:-1])[..., None] for one in columns]
    return np.concatenate([pixel, *broadcast], axis=-1)


def _located(rows: FloatArray, shape: tuple[int, ...]) -> Located:
    return Located(
        position_m=rows[:, :3].reshape(*shape, 3),
        latitude=rows[:, 3].reshape(shape),
        longitude=rows[:, 4].reshape(shape),
        altitude=rows[:, 5].reshape(shape),
        sigma_m=rows[:, 6].reshape(shape),
        covariance_m2=rows[:, [7, 8, 8, 9]].reshape(*shape, 2, 2),
    )


def _time(at: datetime | None) -> str | None:
    if at is not None and at.tzinfo is None:
        raise ValueError(f"{at} has no time zone")
    return None if at is None else at.isoformat()
