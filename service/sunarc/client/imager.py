"""Requests to an imager: every route of its service."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from datetime import date, datetime
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .answers import (
    BackProjection,
    Condition,
    Finding,
    FloatArray,
    ImagerEvent,
    Located,
    Projection,
    parsed,
    read_conditions,
)
from .requests import (
    Requests,
    _format_day,
    _format_image_name,
    _format_number,
    _format_time,
    _make_detail_query,
    _make_point_rows,
    _parse_located,
    _quote_name,
    _require_expected_content,
)
from .transport import ImagerError


class Imager(Requests):
    """An imager's service. Times are aware datetimes; without one, the answer is for now.

    Parameters
    ----------
    address : as "http://imager:8080".
    camera : of several in one store; the service's own unless given.
    calibration : id of the calibration to be answered with, or "best": the least uncertain one of the pose epoch; the
        one that is valid at the time unless given.
    token : where reading needs one.
    timeout_s : of one request.
    retries : how often a request is asked again after 429, 503 or no connection, waiting longer each time.
    """

    def back_project(self, pixels: ArrayLike, *, at: datetime | None = None) -> BackProjection:
        """Return the directions of pixels (..., 2)."""
        rows, calibration, shape = self._ask_rows("/back-project", pixels, 2, at)
        zenith, azimuth, east, north, up, sigma, inside = np.moveaxis(rows, -1, 0)
        direction = np.stack([east, north, up], axis=-1).reshape(*shape, 3)
        columns = (column.reshape(shape) for column in (zenith, azimuth, sigma, inside == 1.0))
        first, second, third, fourth = columns
        return BackProjection(first, second, direction, third, fourth, calibration)

    def project(self, direction: ArrayLike, *, at: datetime | None = None) -> Projection:
        """Return where vectors (..., 3), east-north-up, of any length but 0, land."""
        rows, calibration, shape = self._ask_rows("/project", direction, 3, at)
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
        rows, _, shape = self._ask_rows("/back-project", pixels, 2, at, draws=draws, seed=seed)
        return rows[..., 2:5].reshape(draws, *shape, 3)

    def project_draws(
        self, direction: ArrayLike, *, draws: int, seed: int = 0, at: datetime | None = None
    ) -> FloatArray:
        """Return pixels (draws, ..., 2) of vectors (..., 3), by the draws of `back_project_draws`."""
        rows, _, shape = self._ask_rows("/project", direction, 3, at, draws=draws, seed=seed)
        return rows.reshape(draws, *shape, 2)

    def geolocate(
        self,
        pixels: ArrayLike,
        *,
        height_m: ArrayLike,
        height_sigma_m: float = 0.0,
        at: datetime | Sequence[datetime] | None = None,
    ) -> tuple[Located, Located]:
        """Return where clouds are that pixels (..., 2) see, and where their shadows are.

        Parameters
        ----------
        pixels : (..., 2) px.
        height_m : (...) or one: of the cloud base above the camera's altitude.
        height_sigma_m : 1-sigma of the height.
        at : gives the calibration and the sun; a sequence, along the last dimension of the pixels' (...), gives one
            time for each, of at most 366 days and 8 calibrations.
        """
        one_time = at if at is None or isinstance(at, datetime) else None
        points = _make_point_rows(pixels, height_m, height_sigma_m, times=None if one_time else at)
        rows, _, shape = self._ask_rows("/geolocate", points, points.shape[-1], one_time)
        return _parse_located(rows[:, :10], shape), _parse_located(rows[:, 10:], shape)

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
        points = _make_point_rows(pixels, height_m, height_sigma_m)
        rows, _, shape = self._ask_rows("/geolocate", points, points.shape[-1], at, draws=draws, seed=seed)
        return rows[..., :3].reshape(draws, *shape, 3), rows[..., 6:9].reshape(draws, *shape, 3)

    def calibration(
        self,
        calibration_id: str | None = None,
        *,
        at: datetime | None = None,
        detail: Literal["whole", "camera"] = "whole",
    ) -> dict[str, Any]:
        """Return a calibration document: the one that answers, whole or its camera alone, or any by its id."""
        if calibration_id is not None:
            return self._ask_json(f"/calibrations/{_quote_name(calibration_id)}")
        return self._ask_json(
            "/calibration", at=_format_time(at), calibration=self._chosen, detail=_make_detail_query(detail)
        )

    def renewed(
        self, tag: str | None, *, detail: Literal["whole", "camera"] = "whole"
    ) -> tuple[dict[str, Any], str] | None:
        """Return the calibration document that answers now with its ETag; None where that is the one given."""
        query = {"calibration": self._chosen, "detail": _make_detail_query(detail)}
        answer = self._transport.ask_if_changed(f"{self._prefix}/calibration", query, tag=tag)
        if answer is None:
            return None
        with _require_expected_content():
            return dict(json.loads(answer[0])), answer[1].get("ETag", "")

    def calibrations(self, *, state: str | None = None, provisional: bool = False) -> Iterator[dict[str, Any]]:
        """Yield the history of calibrations, the newest first; of one state, or with provisional poses, if asked."""
        return self._ask_pages(
            "/calibrations", "calibrations", state=state, provisional="true" if provisional else None
        )

    def activate(self, calibration_id: str, *, reason: str) -> dict[str, Any]:
        """Make a stored calibration current from now on; needs the token of changes."""
        return self._ask_change(f"/calibrations/{_quote_name(calibration_id)}/activate", reason=reason)

    def pin(self, calibration_id: str, *, reason: str) -> dict[str, Any]:
        """Keep the current calibration whatever a refit finds; needs the token of changes."""
        return self._ask_change(f"/calibrations/{_quote_name(calibration_id)}/pin", reason=reason)

    def unpin(self, calibration_id: str, *, reason: str) -> dict[str, Any]:
        """Allow refits to replace the current calibration; needs the token of changes."""
        return self._ask_change(f"/calibrations/{_quote_name(calibration_id)}/unpin", reason=reason)

    def close_epoch(self, epoch_id: str, *, reason: str) -> dict[str, Any]:
        """Close a pose epoch that was begun by mistake; needs the token of changes."""
        return self._ask_change(f"/epochs/{_quote_name(epoch_id)}/close", reason=reason)

    def refits(self) -> Iterator[dict[str, Any]]:
        """Yield the refits, the newest first."""
        return self._ask_pages("/refits", "refits")

    def refit(self, refit_id: str) -> dict[str, Any]:
        """Return one refit."""
        return self._ask_json(f"/refits/{_quote_name(refit_id)}")

    def request_refit(self, *, reason: str = "on request") -> dict[str, Any]:
        """Ask for a refit, and return it; needs the token of changes."""
        return self._ask_change("/refits", reason=reason)

    def export(self, form: str, *, at: datetime | None = None) -> bytes:
        """Return the calibration as a file: opencv, ocamcalib, asi-core (a zip), mrcal, netcdf or npz."""
        return self._ask_content("/calibration", format=form, at=_format_time(at), calibration=self._chosen)

    def map(self, *, at: datetime | None = None, sun_radius_deg: float | None = None) -> dict[str, NDArray[Any]]:
        """Return the map of directions by name: zenith, azimuth, direction, sigma and others, (height, width, ...)."""
        radius = _format_number(sun_radius_deg)
        return self._ask_arrays(
            "/back-projection-map", at=_format_time(at), sun_radius_deg=radius, calibration=self._chosen
        )

    def remap(
        self,
        *,
        grid: Literal["sky", "ground"] = "sky",
        size: int = 1024,
        height_m: float | None = None,
        half_width_m: float | None = None,
        at: datetime | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Return map_x, map_y (size, size) for `cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR)`."""
        return self._ask_arrays(
            "/remap", at=_format_time(at), **self._make_grid_query(grid, size, height_m, half_width_m)
        )

    def rectified(
        self,
        time: datetime | str,
        *,
        grid: Literal["sky", "ground"] = "sky",
        size: int = 1024,
        height_m: float | None = None,
        half_width_m: float | None = None,
    ) -> bytes:
        """Return a composite's preview on a grid of the sky, or of the ground under clouds at a height, as PNG."""
        path = f"/images/{_quote_name(_format_image_name(time))}/rectified"
        return self._ask_content(path, **self._make_grid_query(grid, size, height_m, half_width_m))

    def sun_mask(self, *, radius_deg: float = 10.0, at: datetime | None = None) -> bytes:
        """Return a PNG of the image's size: 255 within a radius of the sun."""
        return self._ask_content(
            "/masks/sun", radius_deg=_format_number(radius_deg), at=_format_time(at), calibration=self._chosen
        )

    def obstruction_mask(self, *, form: str = "png") -> bytes:
        """Return the obstructions: png (255 free, 128 unknown, 64 dirt, 0 hidden), or npz of probabilities."""
        return self._ask_content("/masks/obstructions", format=form)

    def horizon(self) -> dict[str, Any]:
        """Return the horizon that the camera sees: elevation, 1-sigma and openings by azimuth, degrees."""
        return self._ask_json("/horizon")

    def horizon_mask(self, *, elevation_deg: float = 0.0, at: datetime | None = None) -> bytes:
        """Return a PNG of the image's size: 255 where it shows the sky above an elevation, and nothing hides it."""
        return self._ask_content(
            "/masks/horizon", elevation_deg=_format_number(elevation_deg), at=_format_time(at), calibration=self._chosen
        )

    def images(self, *, since: datetime | None = None, until: datetime | None = None) -> Iterator[dict[str, Any]]:
        """Yield the kept composites with since <= time < until, the newest first: time, calibration and bytes."""
        return self._ask_pages("/images", "images", since=_format_time(since), until=_format_time(until))

    def image(self, time: datetime | str, *, form: str | None = None, width: int | None = None) -> bytes:
        """Return an image by a time that `images` has: as it is kept, or as `form` asks, png or jpeg.

        A composite is kept as png (16 bit linear counts with metadata) and as jpeg, the first of which is returned;
        a picture of another source as that wrote it. With a width in px it is a thumbnail of 8 bits.
        """
        path = f"/images/{_quote_name(_format_image_name(time))}"
        return self._ask_content(path, format=form, width=None if width is None else str(width))

    def latest_image(self, *, width: int | None = None) -> bytes:
        """Return the newest composite's preview, or a thumbnail of it, as JPEG."""
        return self._ask_content("/image/latest", width=None if width is None else str(width))

    def sun(self, *, at: datetime | None = None) -> dict[str, Any]:
        """Return where the sun is, and on which pixel."""
        return self._ask_json("/sun", at=_format_time(at), calibration=self._chosen)

    def sun_track(self, *, day: date | None = None, step_s: int | None = None) -> dict[str, Any]:
        """Return the sun's way over a solar day, today unless given: times, directions and pixels."""
        step = None if step_s is None else str(step_s)
        return self._ask_json("/sun/track", date=_format_day(day), step_s=step, calibration=self._chosen)

    def sun_points(
        self,
        *,
        since: datetime | None = None,
        until: datetime | None = None,
        accepted: bool | None = None,
        residuals: bool = False,
        body: str = "sun",
    ) -> Iterator[dict[str, Any]]:
        """Yield a body's (`venus`, `star:HIP32349`; `all`) sightings with since <= time < until, the newest first."""
        query = {"accepted": None if accepted is None else str(accepted).lower(), "residuals": str(residuals).lower()}
        return self._ask_pages(
            "/sun-points", "sun_points", since=_format_time(since), until=_format_time(until), body=body, **query
        )

    def overlay(self, *, at: datetime | None = None) -> dict[str, Any]:
        """Return lines to draw over the image: zenith circles, azimuths, ways of the sun."""
        return self._ask_json("/overlay", at=_format_time(at), calibration=self._chosen)

    def uncertainty(self, *, cells: int | None = None, at: datetime | None = None) -> dict[str, Any]:
        """Return the 1-sigma on a coarse grid of the image."""
        given = None if cells is None else str(cells)
        return self._ask_json("/uncertainty", cells=given, at=_format_time(at), calibration=self._chosen)

    def difference(self, other: str, *, cells: int | None = None, at: datetime | None = None) -> dict[str, Any]:
        """Return how far another calibration's directions are from these, on a coarse grid of the image."""
        given = None if cells is None else str(cells)
        return self._ask_json("/difference", other=other, cells=given, at=_format_time(at), calibration=self._chosen)

    def past_events(
        self,
        *,
        since: datetime | None = None,
        until: datetime | None = None,
        severity: str | None = None,
        kind: str | None = None,
        to_acknowledge: bool = False,
    ) -> Iterator[dict[str, Any]]:
        """Yield the stored events with since <= time < until, the newest first; `events` are those to come."""
        query = {"severity": severity, "kind": kind, "to_acknowledge": "true" if to_acknowledge else None}
        return self._ask_pages("/events", "events", since=_format_time(since), until=_format_time(until), **query)

    def acknowledge(self, event: int, *, reason: str = "seen") -> dict[str, Any]:
        """Acknowledge an event by its `id`, and return it; needs the token of changes."""
        return self._ask_change(f"/events/{event}/acknowledge", reason=reason)

    def move_picture(
        self, event: int, side: Literal["before", "after"], *, horizon: bool = False, width: int | None = None
    ) -> bytes:
        """Return the picture before or after a move, by its event's `id`, as JPEG; with the horizon if asked."""
        given = None if width is None else str(width)
        return self._ask_content(f"/events/{event}/pictures/{side}", horizon="true" if horizon else None, width=given)

    def cameras(self) -> dict[str, Any]:
        """Return the cameras that the archive knows, and the name of the one that is asked by default."""
        return self._ask_service_json("/v1/cameras")

    def status(self) -> dict[str, Any]:
        """Return everything at a glance."""
        return self._ask_service_json("/v1/status")

    def metrics(self) -> str:
        """Return the numbers for Prometheus, as text."""
        return self._transport.ask("/metrics", {})[0].decode()

    def alive(self) -> bool:
        """Return whether the service answers at all."""
        return self._is_answered("/healthz")

    def ready(self) -> bool:
        """Return whether the service is ready or degraded: it can answer."""
        return self._is_answered("/readyz")

    def conditions(self) -> tuple[Condition, ...]:
        """Return why the service is degraded or not ready; empty when it is ready. Select by code."""
        status = self._ask_service_json("/v1/status")
        with _require_expected_content():
            return read_conditions(status)

    def events(self, *, after: str | None = None, silent_s: float = 60.0) -> Iterator[ImagerEvent]:
        """Yield events for as long as it is iterated over; first a "state" with the present state.

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
                with _require_expected_content():
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
        with _require_expected_content():
            verdict = document["verdict"]
            uncoded = [{"code": "uncoded", "data": {"text": text}} for text in verdict["reasons"]]  # version 0.2
            pairs = zip(verdict.get("findings", uncoded), verdict["reasons"], strict=True)
            return tuple(Finding(finding["code"], finding["data"], text) for finding, text in pairs)

    def sightings_by_day(self, *, since: date | None = None, until: date | None = None) -> list[dict[str, Any]]:
        """Return the counts of sightings by verdict of each solar day, the newest first; 366 days at most."""
        return self._ask_list("/sun-points/days", "days", since=_format_day(since), until=_format_day(until))

    def days(self, *, since: date | None = None, until: date | None = None) -> Iterator[dict[str, Any]]:
        """Yield the verdicts of the solar days with since <= date < until, the newest first."""
        return self._ask_pages("/days", "days", since=_format_day(since), until=_format_day(until))

    def housekeeping(
        self, *, step: str = "hour", since: datetime | None = None, until: datetime | None = None
    ) -> list[dict[str, Any]]:
        """Return free disk space and the camera's temperature by "hour" or "day", the newest first."""
        return self._ask_list("/housekeeping", "rows", step=step, since=_format_time(since), until=_format_time(until))

    def nights(self, *, images: bool = False) -> Iterator[dict[str, Any]]:
        """Yield the verdicts of the nights, the newest first, with the numbers of their images where asked for."""
        return self._ask_pages("/nights", "nights", images="true" if images else None)

    def night_image(self, night: date) -> bytes:
        """Return the picture of a night, by the date of its evening, as JPEG."""
        return self._ask_content(f"/nights/{night.isoformat()}/image")

    def night_bodies(self, night: date) -> dict[str, Any]:
        """Return the stars, planets and the moon in the picture of a night, and which were detected."""
        return self._ask_json(f"/nights/{night.isoformat()}/bodies")

    def day_air(self, day: date) -> dict[str, Any]:
        """Return the air that was measured on a solar day."""
        return self._ask_json(f"/days/{day.isoformat()}/air")

    def set_day_air(
        self, day: date, *, temperature_c: float | None = None, pressure_hpa: float | None = None
    ) -> dict[str, Any]:
        """Set the air that was measured on a solar day; None: not measured. Needs the token of changes."""
        air = {"temperature_c": temperature_c, "pressure_hpa": pressure_hpa}
        return self._ask_change(f"/days/{day.isoformat()}/air", method="PUT", **air)
