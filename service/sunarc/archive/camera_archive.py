"""An archive bound to one camera."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from functools import partial
from types import MappingProxyType
from typing import Any

from sunarc.archive.archive import Archive
from sunarc.archive.values import Event, EventSeverity
from sunarc.findings import Finding, Messages
from sunarc.sky.site import Site


class CameraArchive:
    """The methods of an archive that concern one camera, without its name; see `Archive` for each.

    Parameters
    ----------
    archive : open.
    name : of the camera.
    site : where it stands.
    """

    def __init__(self, archive: Archive, *, name: str, site: Site) -> None:
        self.archive = archive
        self.name = name
        self.site = site
        self.add_housekeeping = partial(archive.add_housekeeping, name)
        self.current_calibration = partial(archive.current_calibration, name)
        self.current_epoch = partial(archive.current_epoch, name)
        self.current_model = partial(archive.current_model, name)
        self.damaged_calibration = partial(archive.damaged_calibration, name)
        self.dates_with_points = partial(archive.dates_with_points, name)
        self.days = partial(archive.days, name)
        self.epochs = partial(archive.epochs, name)
        self.events = partial(archive.events, name)
        self.exclude = partial(archive.exclude, name)
        self.expire_housekeeping = partial(archive.expire_housekeeping, name)
        self.last_served = partial(archive.last_served, name)
        self.add_night_image = partial(archive.add_night_image, name)
        self.begin_night_verdict = partial(archive.begin_night_verdict, name)
        self.finish_night = partial(archive.finish_night, name)
        self.newest_sighting_time = partial(archive.newest_sighting_time, name)
        self.night_images = partial(archive.night_images, name)
        self.nights = partial(archive.nights, name)
        self.observation_times = partial(archive.observation_times, name)
        self.open_epoch = partial(archive.open_epoch, name)
        self.readmit = partial(archive.readmit, name)
        self.record = partial(archive.camera, name)
        self.refits = partial(archive.refits, name)
        self.sightings_of_ids = partial(archive.sightings_of_ids, name)
        self.site_at = partial(archive.site_at, name, site)
        self.split_epoch = partial(archive.split_epoch, name)
        self.sun_candidates = partial(archive.sun_candidates, name)
        self.sun_levels = partial(archive.sun_levels, name)
        self.sun_point_columns = partial(archive.sun_point_columns, name)
        self.sun_points = partial(archive.sun_points, name)
        self.widen_clock_errors = partial(archive.widen_clock_errors, name)

    def add_event(
        self,
        finding: Finding,
        messages: Messages,
        *,
        time: datetime,
        severity: EventSeverity,
        kind: str | None = None,
        details: Mapping[str, Any] = MappingProxyType({}),
    ) -> Event:
        """Store the event of a finding and return it; `details` are what the finding's data do not say."""
        event = Event.of(finding, messages, time=time, severity=severity, camera=self.name, kind=kind, details=details)
        return self.archive.add_event(event)
