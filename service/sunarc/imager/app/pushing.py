"""The workers that send messages to receivers elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.archive.notices import CameraState
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.runtime.supervisor import Supervised
from sunarc.imager.workers.mqtt import MqttBroker
from sunarc.imager.workers.options import PushOptions
from sunarc.imager.workers.push import NoticeWorker, PushWorker, Sink, Webhook, webhook_name


def push_workers(
    options: PushOptions,
    *,
    archive: Archive,
    states: Callable[[], Mapping[str, CameraState]],
    clock: Clock,
    board: StatusRegistry,
    client: str,
    every_s: float,
) -> tuple[Supervised, ...]:
    """Return the worker that writes notices and one worker for each receiver; nothing where there is no receiver.

    Parameters
    ----------
    options : the receivers.
    archive : where notices are.
    states : returns how every camera is, by name.
    clock : real time.
    board : where receivers that fail are shown.
    client : what this service is called at a broker.
    every_s : seconds between two queries of the cameras.
    """
    names = [*(["mqtt"] if options.mqtt else []), *map(webhook_name, options.webhooks)]
    if not names:
        if archive.notices.sink_states():  # a start writes nothing where nothing has to be: the disk may be full
            archive.notices.name_sinks(())  # else notices would wait for ever
        return ()
    notices = NoticeWorker(archive=archive, states=states, sinks=names, clock=clock, board=board, every_s=every_s)
    sinks = receivers(options, states=lambda: notices.latest, clock=clock, client=client)
    workers = [PushWorker(archive=archive, sink=sink, clock=clock, board=board) for sink in sinks]
    return (
        Supervised(name="notices", make_worker=lambda: notices, optional=True),
        *(
            Supervised(name=f"push_{sink.name}", make_worker=partial(_return_worker, worker), optional=True)
            for sink, worker in zip(sinks, workers, strict=True)
        ),
    )


def receivers(
    options: PushOptions, *, states: Callable[[], Mapping[str, CameraState]], clock: Clock, client: str
) -> list[Sink]:
    """Return the receivers of the options; `push_workers` describes the parameters."""
    sinks: list[Sink] = [Webhook(url, secret_file=options.webhook_secret_file, clock=clock) for url in options.webhooks]
    if options.mqtt is not None:
        sinks.append(MqttBroker(options, states=states, clock=clock, client=client))
    return sinks


def _return_worker(worker: PushWorker) -> PushWorker:
    return worker


def imager_states(camera: CameraArchive, board: StatusRegistry) -> Callable[[], Mapping[str, CameraState]]:
    """Return a function that returns the state of an imager's camera."""

    def states() -> Mapping[str, CameraState]:
        snapshot, record = board.snapshot(), camera.archive.calibrations.current(camera.name)
        state = CameraState(
            health=snapshot.health,
            state=snapshot.state,
            state_text=snapshot.state_text,
            conditions=snapshot.conditions,
            calibration=None if record is None else record.id,
            calibrated_at=None if record is None else record.created_at,
            sky_rms_deg=None if record is None else record.document.get("uncertainty", {}).get("sky_rms_deg"),
        )
        return {camera.name: state}

    return states
