"""The parts of a running imager."""

from __future__ import annotations

import logging
from collections.abc import Callable, Container, Sequence
from dataclasses import replace
from datetime import date, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

import sunarc
from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S
from sunarc.common.errors import OutsideError
from sunarc.common.utc import MICROSECOND
from sunarc.detection.values import Detection
from sunarc.imager.app.cameras import camera_record, note_other_camera, require_same_camera
from sunarc.imager.app.status_line import NO_FRAME_YET
from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.archive.database.recovery import Recovery
from sunarc.imager.archive.database.store import Reserve
from sunarc.imager.archive.images import ImageStore, time_in_name
from sunarc.imager.archive.move_pictures import MovePictures
from sunarc.imager.archive.obstructions import ObstructionLearner
from sunarc.imager.archive.pictures_of_one_time import ELSEWHERE
from sunarc.imager.archive.values import Refit
from sunarc.imager.cameras.frame import Frame, SkyCamera
from sunarc.imager.cameras.options import WHOLE_SECONDS_S, SnapshotOptions
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.runtime.supervisor import Supervised, Worker
from sunarc.imager.settings.model import Settings
from sunarc.imager.workers import upkeep
from sunarc.imager.workers.calibrating.day_judge import DayJudge, LearnedCadence
from sunarc.imager.workers.calibrating.provisional_pose import FirstPose, ProvisionalPoseEstimator
from sunarc.imager.workers.calibrating.refit import RefitWorker
from sunarc.imager.workers.calibrating.watch import WatchWorker
from sunarc.imager.workers.capture import CaptureWorker
from sunarc.imager.workers.capture_status import OverdueSightings
from sunarc.imager.workers.clock_watch import ClockWatch, FrameTime
from sunarc.imager.workers.compose import ComposeWorker, image_document
from sunarc.imager.workers.detect import DetectWorker, FrozenFrames, SightingWriteBuffer
from sunarc.imager.workers.exposures import SunExposures
from sunarc.imager.workers.feed import FeedWorker
from sunarc.imager.workers.hub_connection import HubConnection
from sunarc.imager.workers.night.exposures import MoonCapture, MoonExposures, NightCapture, NightExposures
from sunarc.imager.workers.night.night import NightWorker
from sunarc.imager.workers.options import NightOptions
from sunarc.imager.workers.replay import ReplayWorker
from sunarc.imager.workers.sun_prediction import SunPredictor
from sunarc.sky.night import moon_disc
from sunarc.sky.site import Site

if TYPE_CHECKING:  # a GigE camera's process does without
    from sunarc.imager.live.folder_archive import FolderAnalysis, FolderArchiveWorker
    from sunarc.imager.live.folder_worker import FolderWorker
    from sunarc.imager.live.snapshots import SnapshotWorker

_WAITING_FRAMES = 4


def night_capture(options: NightOptions, site_with_air_at: Callable[[datetime], Site]) -> NightCapture | None:
    """Return the capture of night images, whose frames go to the night worker; None where the night is switched off."""
    if not options.enabled:
        return None
    moon = MoonExposures(lambda time: moon_disc(time.timestamp(), site_with_air_at(time)))
    return NightCapture(
        NightExposures(),
        DropOldestQueue(capacity=_WAITING_FRAMES),
        MoonCapture(moon, DropOldestQueue(capacity=_WAITING_FRAMES)),
    )


def night_worker(service: Service, night: NightCapture) -> NightWorker:
    """Return the worker that finds and names stars."""
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
        obstructions=service.obstructions,
    )


# What the store knows of the time before the service started, so that a restart hides nothing.


class _Filters(TypedDict):
    until: datetime | None
    largest_clock_error_s: float
    newest_first: bool
    limit: int


def restore_last_known(
    board: StatusRegistry,
    *,
    archive: Archive,
    images: ImageStore,
    camera: str,
    until: datetime | None,
) -> None:
    """Write on the board when the last frame and the last accepted sighting were, as the store has them.

    Parameters
    ----------
    board : where they are shown until newer ones come.
    archive, images : what was stored; where that cannot be read, nothing is written.
    camera : whose sightings.
    until : now; later times are of a clock that was ahead. None where times jump by nature (replay, simulation).
    """
    filters: _Filters = {"until": until, "largest_clock_error_s": MAX_CLOCK_ERROR_S, "newest_first": True, "limit": 1}
    try:
        points = archive.sightings.find(camera, body=None, **filters)
        sightings = archive.sightings.find(camera, accepted=True, **filters)
        frames: list[datetime] = [point.time for point in points]
        if (image_at := images.newest_at(kind="hdr.png", until=until)) is not None:
            frames.append(image_at)
    except (OutsideError, OSError) as error:
        _log.warning("the times of the last frame and sighting cannot be read from the store: %s", error)
        return
    if frames:
        board.note(last_frame_at=max(frames))
    if sightings:
        board.note(last_sighting_at=sightings[0].time)


_log = logging.getLogger(__name__)
_WAITING_CYCLES = 4
_WAITING_SUN_FRAMES = 8
_ONE_IMAGE_S = 1.0
"""Slot of the images that others have taken: each has one sighting."""


class Service:
    """The parts of a running imager.

    Parameters
    ----------
    settings : what was set.
    archive : open, of this version's revision.
    clock : real time.
    open_camera : opens the camera that the settings name.
    recovered : what was done about a lost database before the start.
    folder_analysis : of a followed folder's older images; None leaves them to `sunarc ingest`.
    """

    def __init__(
        self,
        settings: Settings,
        *,
        archive: Archive,
        clock: Clock,
        open_camera: Callable[[], SkyCamera],
        recovered: Recovery | None = None,
        folder_analysis: FolderAnalysis | None = None,
    ) -> None:
        self._recovered = recovered
        self._folder_analysis = folder_analysis
        self.settings = settings
        self.archive = archive
        self.camera = CameraArchive(archive, name=settings.name, site=settings.place)
        self.clock = clock
        self.board = StatusRegistry(version=sunarc.__version__, started_at=clock.now(), monotonic=clock.monotonic)
        self.frame_time = FrameTime(clock, follows_camera=settings.dated_by_camera, speed=settings.capture.speed)
        self.clock_watch = self._new_clock_watch()
        self.predictor = SunPredictor(self.camera)
        self.images = ImageStore(settings.images, options=settings.disk)
        self.move_pictures = MovePictures(settings.moves)
        self.obstructions = ObstructionLearner(self.camera, settings.obstructions)
        self.reserve = Reserve(settings.reserve, size_bytes=int(settings.disk.reserve_mb * 1e6))
        restore_last_known(
            self.board,
            archive=archive,
            images=self.images,
            camera=settings.name,
            until=clock.now() if self._in_real_time else None,
        )
        self.keeper = SightingWriteBuffer(archive, board=self.board)
        self.overdue = self._overdue_sightings()
        self.frozen = FrozenFrames(self.camera, board=self.board)
        self.exposures = SunExposures(
            settings.sun_exposure,
            apparent_zenith=self._apparent_zenith,
            clear_level_per_us=self._clear_level_per_us,
            board=self.board,
        )
        self.watch = self.watch_worker()
        self.cycles: DropOldestQueue[Sequence[Frame]] = DropOldestQueue(capacity=_WAITING_CYCLES)
        self.sun_frames: DropOldestQueue[Frame] = DropOldestQueue(capacity=_WAITING_SUN_FRAMES)
        self.night = night_capture(settings.night, self.camera.site_with_air_at)
        self.days = DayJudge(
            camera=self.camera,
            cadence_s=lambda: self.cadence.at(self.frame_time.now()),
            sun_zenith_deg=settings.capture.sun_zenith_deg,
            now=self.frame_time.now,
            request_refit=self.request_refit,
            waiting=self._waiting_days,
            hidden=self.obstructions.hides_sun,
        )
        self.cadence = self._new_learned_cadence()
        self.folder, self.folder_archive = self._followed_folder()
        self.snapshots = self._snapshot_worker()
        self._open_camera = open_camera

    def _new_clock_watch(self) -> ClockWatch:
        return ClockWatch(
            frame_time=self.frame_time,
            camera=self.camera,
            options=self.settings.clock,
            camera_error_s=self._stated_clock_error_s,
            finds_steps=self._in_real_time,
            board=self.board,
        )

    @property
    def _stated_clock_error_s(self) -> float | None:
        """Bound of the error of times that frames or files state; None where the host's clock dates them."""
        if self.settings.folder is not None and self.settings.source == "folder":
            stated_s = self.settings.folder.clock_error_s
            return WHOLE_SECONDS_S if stated_s is None else min(stated_s, WHOLE_SECONDS_S)
        return self.settings.capture.camera_clock_error_s if self.settings.dated_by_camera else None

    @property
    def _in_real_time(self) -> bool:
        """Return whether the frames' time passes as the host's does; a replay's, folder's or simulation's jumps."""
        return self.settings.source not in {"replay", "folder"} and self.settings.capture.speed == 1.0

    def _new_learned_cadence(self) -> LearnedCadence:
        folder = self.settings.folder if self.settings.source == "folder" else None
        return LearnedCadence(self.camera, self.settings.capture.cadence_s if folder is None else folder.cadence_s)

    def _followed_folder(self) -> tuple[FolderWorker | None, FolderArchiveWorker | None]:
        """Return the follower of the folder of the settings, and the analysis of its older images; None without one."""
        settings, options = self.settings, self.settings.folder
        if settings.source != "folder" or options is None:
            return None, None
        from sunarc.imager.live.folder_archive import FolderArchiveWorker  # noqa: PLC0415
        from sunarc.imager.live.folder_conditions import time_rules  # noqa: PLC0415
        from sunarc.imager.live.folder_worker import FolderWorker  # noqa: PLC0415
        from sunarc.imager.live.live_images import LiveImages  # noqa: PLC0415

        rules = time_rules(options)
        behind = FolderArchiveWorker(
            options,
            rules=rules,
            settings=settings,
            camera=self.camera,
            clock=self.clock,
            frame_time=self.frame_time,
            board=self.board,
            analysis=self._folder_analysis,
            look_back=self.days.look_back,
        )
        images = LiveImages(
            self.camera,
            settings=settings,
            method=options.method,
            clock_error_s=self.clock_watch.error_s,
            notice=self._notice_sun,
            show=self.obstructions.take,
            checked=self.obstructions.checked,
            board=self.board,
            looked_at_again=True,
        )
        follower = FolderWorker(
            options,
            camera=self.camera,
            images=images,
            clock=self.clock,
            frame_time=self.frame_time,
            sun_zenith_deg=settings.capture.sun_zenith_deg,
            apparent_zenith=self.predictor.apparent_zenith,
            cadence=self.cadence,
            board=self.board,
            night=None if self.night is None else self.night.frames,
            archive_of=behind.analyse,
            judge_again=self.days.judge_again,
            look_again=self.watch.look_again,
        )
        return follower, behind

    def _snapshot_worker(self) -> SnapshotWorker | None:
        """Return the worker that asks a camera for pictures by HTTP or RTSP; None for another source."""
        settings = self.settings
        options = {"http": settings.http, "rtsp": settings.rtsp}.get(settings.source)
        if options is None:
            return None
        from sunarc.imager.live.live_images import LiveImages  # noqa: PLC0415
        from sunarc.imager.live.rtsp import make_client  # noqa: PLC0415
        from sunarc.imager.live.snapshots import SnapshotWorker  # noqa: PLC0415

        images = LiveImages(
            self.camera,
            settings=settings,
            method="auto",
            clock_error_s=lambda time: self.clock_watch.error_s(time) + options.clock_error_s + worker.within_s,
            notice=self._notice_sun,
            show=self.obstructions.take,
            checked=self.obstructions.checked,
            board=self.board,
        )
        worker = SnapshotWorker(
            make_client(options, self.clock, dated_by_camera=settings.dated_by_camera),
            kind=settings.source,
            keep_images=isinstance(options, SnapshotOptions) and options.keep_images,
            capture=settings.capture,
            name=settings.name,
            images=images,
            clock=self.clock,
            frame_time=self.frame_time,
            apparent_zenith=self.predictor.apparent_zenith,
            store=self.images,
            last=settings.snapshots,
            board=self.board,
            night=None if self.night is None else self.night.frames,
        )
        return worker

    def workers(self) -> tuple[Supervised, ...]:
        """Return the workers that the supervisor keeps alive; consumers first, so that producers find them ready."""
        return (
            self._supervise("clock", lambda: self.clock_watch),
            self._supervise("disk", self.disk_worker),
            self._supervise("database", self.database_worker),
            self._supervise("refit", self.refit_worker),
            *(
                ()
                if self.settings.hub.url is None
                else (replace(self._supervise("feed", self.feed_worker), optional=True),)
            ),
            self._supervise("watch", lambda: self.watch),
            *(() if self.night is None else (self._supervise("night", partial(night_worker, self, self.night)),)),
            *self._source_workers(),
        )

    def _source_workers(self) -> tuple[Supervised, ...]:
        """Return the workers of the source: of frames, or of images that others have taken."""
        if self.folder is not None and self.folder_archive is not None:
            follower, behind = self.folder, self.folder_archive
            return (
                self._supervise("archive", lambda: behind),
                replace(self._supervise("capture", lambda: follower), essential=True, severity="not_ready"),
            )
        if self.snapshots is not None:
            snapshots = self.snapshots
            return (replace(self._supervise("capture", lambda: snapshots), essential=True, severity="not_ready"),)
        capture = self.replay_worker if self.settings.source == "replay" else self.capture_worker
        return (
            replace(self._supervise("detect", self.detect_worker), severity="not_ready"),
            self._supervise("compose", self.compose_worker),
            replace(self._supervise("capture", capture), essential=True, severity="not_ready"),
        )

    def _supervise(self, name: str, make_worker: Callable[[], Worker]) -> Supervised:
        return Supervised(name=name, make_worker=make_worker, options=self.settings.supervisor)

    def _apparent_zenith(self) -> float:
        return self.predictor.apparent_zenith(self.frame_time.now())

    def _overdue_sightings(self) -> OverdueSightings:
        return OverdueSightings(
            stored=lambda: self.keeper.stored,
            apparent_zenith=self._apparent_zenith,
            clock=self.clock,
            frame_time=self.frame_time,
            cadence_s=self.settings.capture.cadence_s,
            board=self.board,
        )

    def check_sightings(self) -> None:
        """Check for overdue sightings while the sun is up; other sources than a camera have their own conditions."""
        if self.settings.source == "aravis":
            self.overdue.check()

    def _clear_level_per_us(self) -> float:
        """Return the clear sun's level over full scale in 1 µs; 0 where the database cannot be read."""
        try:
            return self.predictor.clear_level_per_us(self.frame_time.now())
        except OutsideError:
            return 0.0

    def request_refit(self, reason: str) -> Refit:
        """Ask for a refit, or join the one that waits; the refit worker finds it in the archive."""
        return self.archive.refits.request(Refit.asked(self.settings.name, reason, at=self.frame_time.now()))

    def _waiting_days(self) -> Container[date]:
        if self.folder is None or self.folder_archive is None:
            return frozenset()
        return self.folder_archive.waiting_days(self.folder.waiting_days)

    def judge_completed_days(self) -> None:
        """Judge the days that have ended, while the time that dates them is known."""
        if self.folder_archive is not None and self.folder_archive.holds_all_days:
            return
        if self.frame_time.is_known and self.clock_watch.trusted():
            self.days.judge_ended_days()

    def latest_image(self) -> Path | None:
        """Return the newest preview, or the newest picture of a followed folder."""
        if self.folder is not None:
            return self.folder.newest_picture
        if self.snapshots is not None:
            return self.snapshots.newest_picture
        return self.images.newest(kind="hdr.jpg", until=self.frame_time.now())

    def pictures(self, since: datetime | None, until: datetime | None, limit: int) -> list[tuple[datetime, Path]]:
        """Return times and files of a source's own pictures with since <= time < until, the newest first."""
        if self.folder is not None:
            return self.folder.pictures(since=since, until=until, limit=limit)
        newest = None if self.snapshots is None else self.snapshots.newest_picture
        time = None if newest is None else time_in_name(newest)
        if newest is None or time is None or (since and time < since) or (until and time >= until):
            return []
        return [(time, newest)]

    def open_and_remember(self) -> SkyCamera:
        """Open the camera and store its record; a disk that refuses does not keep it from its work."""
        camera = self._open_camera()
        try:
            require_same_camera(self.archive, name=self.settings.name, info=camera.info)
        except BaseException:
            camera.close()
            raise
        record = camera_record(camera.info, name=self.settings.name, site=self.settings.place)
        try:
            self.archive.cameras.save(note_other_camera(self.archive, record, at=self._change_time()))
        except OutsideError as error:
            _log.warning("could not store camera record: %s", error)
        return camera

    def _change_time(self) -> datetime:
        """Return a time after the last frame of the camera that was open before and not after the next frame.

        While the clock is not trusted, or before the camera's time is known, that is just after the newest sighting.
        """
        now = self.frame_time.now()
        if self.frame_time.is_known and self.clock_watch.trusted():
            return now
        newest = self.archive.sightings.newest_time(self.settings.name, largest_clock_error_s=MAX_CLOCK_ERROR_S)
        return now if newest is None else newest + MICROSECOND

    def capture_worker(self) -> CaptureWorker:
        """Return the worker that drives the camera."""
        return CaptureWorker(
            open_camera=self.open_and_remember,
            clock=self.clock,
            frame_time=self.frame_time,
            options=self.settings.capture,
            name=self.settings.name,
            apparent_zenith=self._apparent_zenith,
            sun_exposures=self.exposures,
            cycles=self.cycles,
            sun_frames=self.sun_frames,
            board=self.board,
            night=self.night,
            on_frame=self.frozen.remember,
        )

    def replay_worker(self) -> ReplayWorker:
        """Return the worker that plays a folder in the camera's place."""
        return ReplayWorker(
            open_camera=self.open_and_remember,
            clock=self.clock,
            frame_time=self.frame_time,
            name=self.settings.name,
            sun_frames=self.sun_frames,
            board=self.board,
        )

    def compose_worker(self) -> ComposeWorker:
        """Return the worker that writes composites."""
        return ComposeWorker(
            self.cycles,
            store=self.images,
            options=self.settings.sensor,
            describe=partial(
                image_document, camera=self.settings.name, site=self.settings.place, predictor=self.predictor
            ),
            show=self.obstructions.take,
            board=self.board,
        )

    def disk_worker(self) -> upkeep.DiskWorker:
        """Return the worker that keeps the disk from filling."""
        return upkeep.DiskWorker(
            store=self.images,
            reserve=self.reserve,
            options=self.settings.disk,
            clock=self.clock,
            age_from=self.clock_watch.cleaning_time,
            board=self.board,
        )

    def database_worker(self) -> upkeep.DatabaseWorker:
        """Return the worker that watches the database's file."""
        recovered, self._recovered = self._recovered, None
        return upkeep.DatabaseWorker(
            archive=self.archive,
            clock=self.clock,
            now=self.frame_time.now,
            board=self.board,
            recovered=recovered,
            waiting=lambda: (
                self.keeper.waiting + len(self.sun_frames) + (0 if self.folder is None else self.folder.n_waiting)
            ),
        )

    def detect_worker(self) -> DetectWorker:
        """Return the worker that detects the sun in images."""
        return DetectWorker(
            self.sun_frames,
            keeper=self.keeper,
            camera=self.settings.name,
            predictor=self.predictor,
            options=self.settings.sensor,
            disc=self.settings.detection,
            clock_error_s=self.clock_watch.error_s,
            report=self.report,
            cadence_s=self.settings.capture.cadence_s,
            frozen=self.frozen,
            checked=self.obstructions.checked,
            board=self.board,
        )

    def report(self, frame: Frame, detection: Detection) -> None:
        """Pass the detection in a sun exposure to the exposure control and to the change detection."""
        self.exposures.report(frame, detection)
        self._notice_sun(frame.time, detection)

    def _notice_sun(self, time: datetime, detection: Detection) -> None:
        """Pass a detected sun, accepted or seen elsewhere, to the change detection."""
        is_sun = detection.accepted or detection.verdict == ELSEWHERE
        if is_sun and detection.x_px is not None and detection.y_px is not None and self.clock_watch.trusted():
            self.watch.notice(
                time,
                x_px=detection.x_px,
                y_px=detection.y_px,
                sigma_px=detection.sigma_px,
                clock_error_s=self.clock_watch.error_s(time),
            )

    def watch_worker(self) -> WatchWorker:
        """Return the worker that compares sightings with the current calibration."""
        settings = self.settings
        return WatchWorker(
            camera=self.camera,
            options=settings.watch,
            reposer=ProvisionalPoseEstimator(
                camera=self.camera,
                options=settings.calibration,
                wander_deg=settings.watch.wander_deg,
                now=self.frame_time.now,
                first=FirstPose.of(settings.first_pose),
                clock_error_s=settings.stated_clock_error_s,
            ),
            now=self.frame_time.now,
            board=self.board,
            host_dates=settings.source != "folder",
            pictures=self.move_pictures,
            newest_picture=self.latest_image,
        )

    def feed_worker(self) -> FeedWorker:
        """Return the worker that sends the archive's rows to the hub."""
        hub = HubConnection(self.settings.hub, camera=self.settings.name, clock=self.clock)
        return FeedWorker(
            camera=self.camera,
            send=hub.send,
            ask=hub.stored_days,
            clock=self.clock,
            board=self.board,
            asked_s=hub.wait_s,
        )

    def refit_worker(self) -> RefitWorker:
        """Return the worker that solves the camera anew."""
        return RefitWorker(
            camera=self.camera,
            options=self.settings.refit,
            calibration=self.settings.calibration,
            cadence_s=self.settings.capture.cadence_s if self.settings.source == "aravis" else _ONE_IMAGE_S,
            clock=self.clock,
            now=self.frame_time.now,
            board=self.board,
            clock_error_s=self.settings.stated_clock_error_s,
            clock_assumed=self.settings.source == "folder",
            may_solve=lambda: self.frame_time.is_known and self.clock_watch.trusted(),
        )


_OF_THE_HUB = ""


def make_recording_workers(service: Service) -> tuple[Supervised, ...]:
    """Return the workers that record housekeeping, since when conditions hold, and the store's room.

    They are made before any condition is set, so that stored times are restored.
    """
    frame_time = service.frame_time

    def now() -> datetime | None:
        return frame_time.now() if frame_time.is_known and service.clock_watch.trusted() else None

    housekeeping = upkeep.HousekeepingWorker(
        camera=service.camera,
        clock=service.clock,
        now=now,
        age_from=service.clock_watch.cleaning_time,
        board=service.board,
    )
    conditions = upkeep.ConditionTimesWorker(
        archive=service.archive,
        camera=service.settings.name,
        board=service.board,
        clock=service.clock,
        passing=[NO_FRAME_YET],
    )
    room = upkeep.StoreRoomWorker(
        archive=service.archive,
        clock=service.clock,
        board=service.board,
        severity="degraded",
        quiet_s=upkeep.QUIET_S,
        patience_s=upkeep.PATIENCE_S,
    )
    return (
        Supervised(name="housekeeping", make_worker=lambda: housekeeping),
        Supervised(name="conditions", make_worker=lambda: conditions),
        Supervised(name="room", make_worker=lambda: room, optional=True),
    )


def hub_recording(archive: Archive, board: StatusRegistry, clock: Clock) -> tuple[Supervised, ...]:
    """Return the workers of a hub's own conditions; whatever its database does, a restart of the hub helps nothing."""
    conditions = upkeep.ConditionTimesWorker(archive=archive, camera=_OF_THE_HUB, board=board, clock=clock)
    room = upkeep.StoreRoomWorker(archive=archive, clock=clock, board=board)
    return (
        Supervised(name="conditions", make_worker=lambda: conditions),
        Supervised(name="room", make_worker=lambda: room, optional=True),
    )
