"""Settings by section."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal
from zoneinfo import ZoneInfo

from pydantic import BaseModel, ConfigDict, field_validator
from sqlalchemy import URL

from sunarc.calibration.model.options import CalibrationOptions
from sunarc.changes.values import WatchOptions
from sunarc.common.errors import InputError
from sunarc.detection.values import DiscOptions
from sunarc.imager.archive.database.connections import server_url
from sunarc.imager.archive.images import DiskOptions
from sunarc.imager.cameras.options import AravisOptions, FolderOptions, ReplayOptions, RtspOptions, SnapshotOptions
from sunarc.imager.runtime.supervisor import SupervisorOptions
from sunarc.imager.web.options import ApiOptions
from sunarc.imager.workers import options
from sunarc.imaging.exposure import SunExposureOptions
from sunarc.sky.site import Site

UTC = "UTC"


@dataclass(frozen=True, slots=True, kw_only=True)
class SiteOptions(Site):
    """Site of the camera, with the time zone of the people there.

    Attributes
    ----------
    timezone : IANA name, as "Pacific/Auckland", of the zone whose local times are shown with those in UTC. No
        computation uses it.
    """

    timezone: str = UTC

    def __post_init__(self) -> None:
        """Refuse a zone that does not exist."""
        Site.__post_init__(self)
        if not zone_exists(self.timezone):
            raise InputError(
                field="site.timezone",
                problem=f"{self.timezone!r} is not a time zone that is known here",
                remedy="give an IANA name as Pacific/Auckland (package tzdata), or UTC",
            )


def zone_exists(name: str) -> bool:
    """Return whether an IANA name is that of a time zone on this machine; UTC always is."""
    try:
        return name == UTC or bool(ZoneInfo(name))
    except (OSError, ValueError, KeyError):  # no such zone, or no list of zones
        return False


class _WithStore(BaseModel):
    """Settings of a service that has an archive."""

    state: Path = Path("/var/lib/sunarc")
    store: str | None = None

    @field_validator("store")
    @classmethod
    def _check_store(cls, store: str | None) -> str | None:
        if store is not None:
            server_url(store)
        return store

    @property
    def archive(self) -> Path | URL:
        """Where the archive is: its file, or the address of its PostgreSQL database."""
        return self.database if self.store is None else server_url(self.store)

    @property
    def database(self) -> Path:
        """The archive's file, where the store is SQLite."""
        return self.state / "sunarc.sqlite"


class HubSettings(_WithStore):
    """Settings of a hub: its archive, the web server, and receivers of messages."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    api: ApiOptions = ApiOptions()
    push: options.PushOptions = options.PushOptions()
    nightly: options.NightlyOptions = options.NightlyOptions()


class Settings(_WithStore):
    """Everything that can be set, by section; `settings.reference` knows which fields are for Python only.

    Attributes
    ----------
    name : the camera's name in the archive and in documents.
    state : folder of the database and the images.
    store : where the archive is: unset, the SQLite file in `state`; or a PostgreSQL database,
        "postgresql+psycopg://USER@HOST/DATABASE" (needs the extra `postgresql`).
    source : where frames come from.
    site : where the camera stands, and the time zone there.
    camera : the GigE Vision camera.
    folder, http : the folder that another program fills, the picture at an address.
    replay : the folder to replay.
    rtsp : the camera that streams.
    sensor, detection : the sensor's properties, and limits of the detection.
    capture, sun_exposure : the cycle, and the control of its sun exposures.
    clock : how the time of the frames is watched.
    calibration, refit : the fit, when and how it is run.
    first_pose : what is known of lens and pose before the first fit.
    watch : thresholds of a change of the camera.
    disk : how much of the disk images may have.
    api : the web server.
    hub : where the archive's rows are sent to.
    push : receivers of messages about conditions, events and calibrations.
    night : whether the stars are observed.
    nightly : what a hub does once a night.
    supervisor : limits of restarts and heartbeats of the workers.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = "imager"
    state: Path = Path("/var/lib/sunarc")
    store: str | None = None
    source: Literal["aravis", "folder", "http", "replay", "rtsp"] = "aravis"
    site: SiteOptions
    camera: AravisOptions | None = None
    folder: FolderOptions | None = None
    http: SnapshotOptions | None = None
    replay: ReplayOptions | None = None
    rtsp: RtspOptions | None = None
    sensor: options.SensorOptions = options.SensorOptions()
    detection: DiscOptions = DiscOptions()
    capture: options.CaptureOptions = options.CaptureOptions()
    sun_exposure: SunExposureOptions = SunExposureOptions()
    clock: options.ClockOptions = options.ClockOptions()
    calibration: CalibrationOptions = CalibrationOptions()
    refit: options.RefitOptions = options.RefitOptions()
    first_pose: options.LensPriorOptions = options.LensPriorOptions()
    watch: WatchOptions = WatchOptions()
    disk: DiskOptions = DiskOptions()
    api: ApiOptions = ApiOptions()
    hub: options.HubOptions = options.HubOptions()
    push: options.PushOptions = options.PushOptions()
    night: options.NightOptions = options.NightOptions()
    nightly: options.NightlyOptions = options.NightlyOptions()
    supervisor: SupervisorOptions = SupervisorOptions()

    @field_validator("site", mode="before")
    @classmethod
    def _add_timezone(cls, site: Any) -> Any:  # noqa: ANN401 - whatever was given
        """Return a site of the library as one with a time zone."""
        if type(site) is not Site:
            return site
        return SiteOptions(**{one.name: getattr(site, one.name) for one in fields(Site)})

    @property
    def place(self) -> Site:
        """The site without its time zone: the one that is computed with, stored and compared."""
        return Site(**{one.name: getattr(self.site, one.name) for one in fields(Site)})

    @property
    def is_replay(self) -> bool:
        """True where the frames' clock is a replay's or a simulation's, not the present time."""
        return self.source == "replay" or self.capture.speed != 1.0

    @property
    def dated_by_camera(self) -> bool:
        """True where the time of the frames is taken from them; else it is the host's, also where files state theirs.

        The times of a folder's images come late, and out of order, those of a camera asked by HTTP are whole seconds of
        its own clock; those of a simulation are the only clock there is.
        """
        if self.source in {"folder", "http", "rtsp"}:
            return self.source != "rtsp" and self.capture.speed != 1.0
        return self.camera is None or self.camera.timestamps == "camera"

    @property
    def stated_clock_error_s(self) -> float | None:
        """The bound of the clock that dated the images, s; None where none is stated, or sightings carry theirs."""
        return self.folder.clock_error_s if self.folder is not None and self.source == "folder" else None

    @property
    def backups(self) -> Path:
        """The folder of the dated copies of the archive."""
        return self.state / "backups"

    @property
    def reserve(self) -> Path:
        """The file that holds the database's room."""
        return self.state / "reserve"

    @property
    def warm_pixels(self) -> Path:
        """The file of the warm pixels that the images of the night showed."""
        return self.state / "warm-pixels.json"

    @property
    def obstructions(self) -> Path:
        """The file of the sums of the obstruction mask."""
        return self.state / "obstructions.npz"

    @property
    def snapshots(self) -> Path:
        """The folder of the last picture of a camera that is asked by HTTP or RTSP."""
        return self.state / "snapshots"

    @property
    def moves(self) -> Path:
        """The folder of the pictures before and after moves of the camera."""
        return self.state / "moves"

    @property
    def images(self) -> Path:
        """The root of the dated image folders."""
        return self.state / "images"
