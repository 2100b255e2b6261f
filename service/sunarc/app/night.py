"""The parts of an imager that work at night."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from typing import TYPE_CHECKING

from sunarc.extras import extra_module
from sunarc.sky.moon import moon_disc
from sunarc.sky.site import Site
from sunarc.workers.bounded_queue import DropOldestQueue
from sunarc.workers.night.exposures import NightCapture, NightExposures
from sunarc.workers.night.moon import MoonCapture
from sunarc.workers.night.moon_exposures import MoonExposures
from sunarc.workers.night.night import NightWorker
from sunarc.workers.night.options import NightOptions

if TYPE_CHECKING:
    from sunarc.app.service import Service

_WAITING_FRAMES = 4


def night_capture(options: NightOptions, site_at: Callable[[datetime], Site]) -> NightCapture | None:
    """Return what joins the night's capture and its worker; None where the night is not worked.

    Raises
    ------
    InputError : it is, and the extra `night` is not installed.
    """
    if not options.enabled:
        return None
    extra_module("ephem", extra="night")
    moon = MoonExposures(lambda time: moon_disc(time.timestamp(), site_at(time)))
    return NightCapture(
        NightExposures(),
        DropOldestQueue(capacity=_WAITING_FRAMES),
        MoonCapture(moon, DropOldestQueue(capacity=_WAITING_FRAMES)),
    )


def night_worker(service: Service, night: NightCapture) -> NightWorker:
    """Return the worker that looks at the stars."""
    return NightWorker(
        night,
        camera=service.camera,
        options=service.settings.sensor,
        apparent_zenith=lambda: service.predictor.apparent_zenith(service.frame_time.now()),
        clock_error_s=service.clock_watch.error_s,
        trusted=service.clock_watch.trusted,
        now=service.frame_time.now,
        request_refit=service.request_refit,
        board=service.board,
        store=service.images,
        warm_pixels=service.settings.warm_pixels,
        resumes=True,
    )
