"""The parts of a running imager, joined."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Sequence

import sunarc
from sunarc.archive import Archive, CameraRecord, ImageStore, Refit
from sunarc.board import ClockStatus, Reason, StatusBoard
from sunarc.cameras import Frame, SkyCamera
from sunarc.clock import Clock, host_clock_state
from sunarc.settings import Settings
from sunarc.supervisor import Supervised
from sunarc.workers import (
    CaptureWorker,
    ComposeWorker,
    DayJudge,
    DetectWorker,
    FrameTime,
    Handover,
    RefitWorker,
    ReplayWorker,
    SunExposures,
    SunPredictor,
)

_WAITING_CYCLES = 4
_WAITING_SUN_FRAMES = 8


class Service:
    """The parts of a running imager, joined.

    Parameters
    ----------
    settings : what was set.
    archive : open, of this version's revision.
    clock : real time.
    open_camera : opens the camera that the settings name.
    """

    def __init__(
        self, settings: Settings, *, archive: Archive, clock: Clock, open_camera: Callable[[], SkyCamera]
    ) -> None:
        self.settings = settings
        self.archive = archive
        self.clock = clock
        self.board = StatusBoard(version=sunarc.__version__, started_at=clock.now(), monotonic=clock.monotonic)
        self.frame_time = FrameTime(clock, follows_camera=settings.dated_by_camera, speed=settings.capture.speed)
        self.predictor = SunPredictor(archive, camera=settings.name, site=settings.site)
        self.exposures = SunExposures(settings.sun_exposure)
        self.cycles: Handover[Sequence[Frame]] = Handover(capacity=_WAITING_CYCLES)
        self.sun_frames: Handover[Frame] = Handover(capacity=_WAITING_SUN_FRAMES)
        self.days = DayJudge(
            archive=archive,
            camera=settings.name,
            site=settings.site,
            cadence_s=settings.capture.cadence_s,
            sun_zenith_deg=settings.capture.sun_zenith_deg,
            options=settings.days,
            now=self.frame_time.now,
            request_refit=self.request_refit,
        )
        self._open_camera = open_camera

    def workers(self) -> tuple[Supervised, ...]:
        """Return what the supervisor keeps alive; consumers first, so that producers find them ready."""
        return (
            Supervised(name="refit", make_worker=self.refit_worker),
            Supervised(name="detect", make_worker=self.detect_worker),
            Supervised(name="compose", make_worker=self.compose_worker),
            Supervised(
                name="capture",
                make_worker=self.replay_worker if self.settings.source == "replay" else self.capture_worker,
            ),
        )

    def request_refit(self, reason: str) -> Refit:
        """Ask for a refit; the refit worker finds it in the archive."""
        return self.archive.add_refit(
            Refit(id=uuid.uuid4().hex, camera=self.settings.name, requested_at=self.frame_time.now(), reason=reason)
        )

    def look_around(self) -> None:
        """Judge the days that have ended, and look at the host's clock."""
        state = host_clock_state()
        self.board.note(clock=ClockStatus(synchronised=state.synchronised, max_error_s=state.error_bound_s))
        if not self.settings.dated_by_camera and not state.synchronised:
            self.board.set_reason(_unsynchronised())
        else:
            self.board.clear_reason("clock_unsynchronised")
        if self.frame_time.known:
            self.days.judge_ended_days()

    def clock_error_s(self) -> float:
        """Return the bound of the error of the frames' times."""
        if self.settings.dated_by_camera:
            return self.settings.capture.camera_clock_error_s
        return host_clock_state().error_bound_s

    def open_and_remember(self) -> SkyCamera:
        """Open the camera and write down what it is."""
        camera = self._open_camera()
        info, site = camera.info, self.settings.site
        self.archive.save_camera(
            CameraRecord(
                name=self.settings.name,
                latitude=site.latitude,
                longitude=site.longitude,
                altitude=site.altitude,
                width=info.width,
                height=info.height,
                model=f"{info.vendor} {info.model}".strip(),
                serial=info.serial,
            )
        )
        return camera

    def capture_worker(self) -> CaptureWorker:
        """Return the worker that drives the camera."""
        return CaptureWorker(
            open_camera=self.open_and_remember,
            clock=self.clock,
            frame_time=self.frame_time,
            options=self.settings.capture,
            name=self.settings.name,
            apparent_zenith=lambda: self.predictor.apparent_zenith(self.frame_time.now()),
            sun_exposures=self.exposures,
            cycles=self.cycles,
            sun_frames=self.sun_frames,
            board=self.board,
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
            self.cycles, store=ImageStore(self.settings.images), options=self.settings.sensor, board=self.board
        )

    def detect_worker(self) -> DetectWorker:
        """Return the worker that looks for the sun."""
        return DetectWorker(
            self.sun_frames,
            archive=self.archive,
            camera=self.settings.name,
            predictor=self.predictor,
            options=self.settings.sensor,
            disc=self.settings.detection,
            clock_error_s=self.clock_error_s,
            report=self.exposures.report,
            board=self.board,
        )

    def refit_worker(self) -> RefitWorker:
        """Return the worker that solves the camera anew."""
        return RefitWorker(
            archive=self.archive,
            camera=self.settings.name,
            site=self.settings.site,
            options=self.settings.refit,
            calibration=self.settings.calibration,
            clock=self.clock,
            now=self.frame_time.now,
            board=self.board,
        )


def _unsynchronised() -> Reason:
    return Reason(
        code="clock_unsynchronised",
        severity="degraded",
        text="the host's clock is not synchronised; an error of 1 s turns the sky by 0.004 degrees",
        remedy="start a time service (systemd-timesyncd or chrony) and let it reach its servers",
    )
