"""The same questions for programs that use asyncio: each is asked in a thread."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from functools import update_wrapper
from typing import Any, Concatenate, ParamSpec, TypeVar

from .imager import Imager

P = ParamSpec("P")
R = TypeVar("R")


def _run_in_thread(
    method: Callable[Concatenate[Imager, P], R],
) -> Callable[Concatenate[AsyncImager, P], Coroutine[Any, Any, R]]:
    async def asking(imager: AsyncImager, /, *args: P.args, **how: P.kwargs) -> R:
        return await asyncio.to_thread(method, imager.imager, *args, **how)

    update_wrapper(asking, method)
    return asking


def _iterate_in_thread(
    method: Callable[Concatenate[Imager, P], Iterator[R]],
) -> Callable[Concatenate[AsyncImager, P], AsyncIterator[R]]:
    async def asking(imager: AsyncImager, /, *args: P.args, **how: P.kwargs) -> AsyncIterator[R]:
        rows = method(imager.imager, *args, **how)
        ended: Any = object()
        while (row := await asyncio.to_thread(next, rows, ended)) is not ended:
            yield row

    update_wrapper(asking, method)
    return asking


class AsyncImager:
    """The methods of `Imager`, to be awaited; those that yield, to be iterated over with `async for`.

    Parameters
    ----------
    imager : what is asked.
    """

    def __init__(self, imager: Imager) -> None:
        self.imager = imager

    back_project = _run_in_thread(Imager.back_project)
    project = _run_in_thread(Imager.project)
    geolocate = _run_in_thread(Imager.geolocate)
    back_project_draws = _run_in_thread(Imager.back_project_draws)
    project_draws = _run_in_thread(Imager.project_draws)
    geolocate_draws = _run_in_thread(Imager.geolocate_draws)
    calibration = _run_in_thread(Imager.calibration)
    renewed = _run_in_thread(Imager.renewed)
    activate = _run_in_thread(Imager.activate)
    pin = _run_in_thread(Imager.pin)
    unpin = _run_in_thread(Imager.unpin)
    acknowledge = _run_in_thread(Imager.acknowledge)
    move_picture = _run_in_thread(Imager.move_picture)
    close_epoch = _run_in_thread(Imager.close_epoch)
    refit = _run_in_thread(Imager.refit)
    request_refit = _run_in_thread(Imager.request_refit)
    export = _run_in_thread(Imager.export)
    map = _run_in_thread(Imager.map)
    remap = _run_in_thread(Imager.remap)
    rectified = _run_in_thread(Imager.rectified)
    sun_mask = _run_in_thread(Imager.sun_mask)
    obstruction_mask = _run_in_thread(Imager.obstruction_mask)
    horizon = _run_in_thread(Imager.horizon)
    horizon_mask = _run_in_thread(Imager.horizon_mask)
    image = _run_in_thread(Imager.image)
    latest_image = _run_in_thread(Imager.latest_image)
    sun = _run_in_thread(Imager.sun)
    sun_track = _run_in_thread(Imager.sun_track)
    overlay = _run_in_thread(Imager.overlay)
    uncertainty = _run_in_thread(Imager.uncertainty)
    difference = _run_in_thread(Imager.difference)
    sightings_by_day = _run_in_thread(Imager.sightings_by_day)
    housekeeping = _run_in_thread(Imager.housekeeping)
    day_air = _run_in_thread(Imager.day_air)
    set_day_air = _run_in_thread(Imager.set_day_air)
    cameras = _run_in_thread(Imager.cameras)
    status = _run_in_thread(Imager.status)
    metrics = _run_in_thread(Imager.metrics)
    alive = _run_in_thread(Imager.alive)
    ready = _run_in_thread(Imager.ready)
    conditions = _run_in_thread(Imager.conditions)
    verdict = _run_in_thread(Imager.verdict)
    calibrations = _iterate_in_thread(Imager.calibrations)
    refits = _iterate_in_thread(Imager.refits)
    images = _iterate_in_thread(Imager.images)
    sun_points = _iterate_in_thread(Imager.sun_points)
    days = _iterate_in_thread(Imager.days)
    nights = _iterate_in_thread(Imager.nights)
    night_image = _run_in_thread(Imager.night_image)
    night_bodies = _run_in_thread(Imager.night_bodies)
    past_events = _iterate_in_thread(Imager.past_events)
    events = _iterate_in_thread(Imager.events)
