"""The composition root: the only place where parts are chosen and joined."""

from __future__ import annotations

import logging
import os
import signal
import threading
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import datetime
from pathlib import Path

import uvicorn

import sunarc
from sunarc.api import create_app
from sunarc.archive import Archive, CameraRecord, ImageStore, Refit, open_archive, upgrade
from sunarc.board import ClockStatus, Reason, StatusBoard
from sunarc.cameras import Frame, SkyCamera, open_aravis, open_replay
from sunarc.clock import Clock, SystemClock, host_clock_state
from sunarc.errors import ConfigurationError
from sunarc.footing import listen, prepare_state
from sunarc.schedule import Schedule
from sunarc.settings import Settings
from sunarc.simulation import ImagerOptions, SceneOptions, run_imager
from sunarc.sky import Site
from sunarc.supervisor import Supervised, Supervisor
from sunarc.systemd import Notifier, notifier_from, watchdog_interval_s
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

_log = logging.getLogger(__name__)
_STOP_WITHIN_S = 4.0
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


def serve(settings: Settings) -> int:
    """Run the service until SIGTERM or SIGINT; return the process's exit code."""
    clock = SystemClock()
    listening = listen(settings.api.host, settings.api.port)
    prepare_state(settings.state)
    upgrade(settings.database)
    service = Service(
        settings,
        archive=open_archive(settings.database),
        clock=clock,
        open_camera=camera_opener(settings, clock),
    )
    notifier = notifier_from(os.environ)
    server = _web_server(service)
    for number in (signal.SIGTERM, signal.SIGINT):  # the web server hands on what it was stopped by; it ends here
        signal.signal(number, lambda *_: None)
    with ExitStack() as stack:
        stack.enter_context(listening)
        stack.callback(service.archive.close)
        supervisor = stack.enter_context(_supervised(service, notifier, on_failed=lambda: _stop_serving(server)))
        stack.enter_context(_scheduled(service))
        notifier.ready(f"serving at http://{settings.api.host}:{settings.api.port}/")
        server.run(sockets=[listening])
        notifier.stopping()
    return 3 if supervisor.failed.is_set() else 0


def camera_opener(settings: Settings, clock: Clock) -> Callable[[], SkyCamera]:
    """Return what opens the camera that the settings name."""
    camera, replay = settings.camera, settings.replay
    if settings.source == "aravis" and camera is not None:
        return lambda: open_aravis(camera, clock)
    if settings.source == "replay" and replay is not None:
        return lambda: open_replay(replay)
    section = "camera" if settings.source == "aravis" else "replay"
    raise ConfigurationError(
        f'setting {section} is missing; add a [{section}] section for source = "{settings.source}"'
    )


def simulate(
    *,
    address: str,
    start: datetime,
    speed: float,
    site: Site,
    lens_seed: int,
    clouds: str,
    nd_transmission: float,
    truth: Path | None,
) -> None:
    """Run a simulated imager until SIGTERM or SIGINT."""
    options = ImagerOptions(
        address=address,
        start=start,
        speed=speed,
        site=site,
        lens_seed=lens_seed,
        clouds=clouds,
        scene=SceneOptions(nd_transmission=nd_transmission),
        truth=truth,
    )
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    run_imager(options, stop)


def _web_server(service: Service) -> uvicorn.Server:
    app = create_app(
        archive=service.archive,
        camera=service.settings.name,
        site=service.settings.site,
        status=service.board.snapshot,
        request_refit=service.request_refit,
        frame_clock=service.frame_time.now,
        latest_image=lambda: ImageStore(service.settings.images).newest(kind="hdr.jpg"),
        options=service.settings.api,
    )
    return uvicorn.Server(
        uvicorn.Config(app, log_level="warning", access_log=False, timeout_graceful_shutdown=1, server_header=False)
    )


def _stop_serving(server: uvicorn.Server) -> None:
    server.should_exit = True


@contextmanager
def _supervised(service: Service, notifier: Notifier, *, on_failed: Callable[[], None]) -> Iterator[Supervisor]:
    interval_s = watchdog_interval_s(os.environ, pid=os.getpid())
    supervisor = Supervisor(
        service.workers(),
        clock=service.clock,
        board=service.board,
        feed=notifier.watchdog,
        check_every_s=1.0 if interval_s is None else min(interval_s / 3.0, 1.0),
        on_failed=on_failed,
    )
    supervisor.start()
    try:
        yield supervisor
    finally:
        supervisor.stop(within_s=_STOP_WITHIN_S)


@contextmanager
def _scheduled(service: Service) -> Iterator[None]:
    schedule = Schedule(
        service.look_around,
        every_s=service.settings.refit.check_every_s,
        clock=service.clock,
        board=service.board,
    )
    schedule.start()
    try:
        yield
    finally:
        schedule.stop(within_s=1.0)


def _unsynchronised() -> Reason:
    return Reason(
        code="clock_unsynchronised",
        severity="degraded",
        text="the host's clock is not synchronised; an error of 1 s turns the sky by 0.004 degrees",
        remedy="start a time service (systemd-timesyncd or chrony) and let it reach its servers",
    )
