"""Calibrations of the service's archive: a refit of it, and a past one again."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import sunarc
from sunarc.calibration.acceptance import distance_px
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle, LensTolerances, PaperOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.quality.tilt import require_level
from sunarc.calibration.quality.widening import add_pose_spread
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.formats.calibration_document import from_document, to_document
from sunarc.imager.archive.archive import Archive, CameraArchive, open_archive
from sunarc.imager.archive.database.recovery import upgrade_present
from sunarc.imager.archive.database.schema import require_file
from sunarc.imager.archive.database.state_folder import lock_state
from sunarc.imager.archive.values import Refit
from sunarc.imager.live.camera_record import known_camera
from sunarc.imager.live.learned_sigma import ValidCamera, learn_sigma
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.settings.model import Settings
from sunarc.imager.workers.calibrating.refit import RefitWorker
from sunarc.imager.workers.calibrating.solver_process import columns_to_sightings
from sunarc.optics.camera import Camera


def calibrate_archive(
    settings: Settings, *, clock: Clock, keep_provisional: bool = False, clock_error_s: float | None = None
) -> tuple[Refit, dict[str, Any] | None]:
    """Fit the camera to the accepted sightings of the archive, as a refit of the service does.

    The result is stored with its sightings, and becomes the current calibration where it is accepted.

    Parameters
    ----------
    settings : camera, site, state folder, and how to fit.
    clock : dates the calibration.
    keep_provisional : see `provisional`.
    clock_error_s : the bound of the clock, s; None for that of the settings.

    Returns
    -------
    The refit with its state and findings, and the calibration document; None where no fit was made.

    Raises
    ------
    InputError : the archive has no images or sightings of this camera; or the served one is tilted by more than the
        settings state.
    OutsideError : a service uses the state folder.
    """
    if settings.store is None:
        require_file(settings.database, command="sunarc ingest FOLDER --config FILE")
    with lock_state(settings.state):
        upgrade_present(settings.archive)
        with open_archive(settings.archive) as archive:
            if known_camera(archive, settings) is None:
                raise InputError(
                    field="POINTS",
                    problem=f"missing, and the archive has no camera {settings.name!r}",
                    remedy="fill it with sunarc ingest or sunarc points import",
                )
            _require_level(archive, settings)
            worker = _new_refit_worker(archive, settings, clock)
            worker.keep_provisional = keep_provisional
            if clock_error_s is not None:
                worker.clock_error_s, worker.clock_assumed = clock_error_s, False
            refit = _carry_out_waiting(worker)
            if refit.calibration is None:
                return refit, None
            if refit.state == "accepted":
                learn_sigma(
                    archive, settings, [ValidCamera(archive.calibrations.model(refit.calibration))], now=clock.now()
                )
            return refit, dict(archive.calibrations.get(refit.calibration).document)


def _require_level(archive: Archive, settings: Settings) -> None:
    """Raise InputError where the camera that is served in its present pose is tilted by more than is stated."""
    record, served = archive.calibrations.current(settings.name), archive.calibrations.current_model(settings.name)
    epochs = archive.epochs.find(settings.name)
    if record is None or served is None or not epochs or record.pose_epoch != epochs[-1].id:
        return
    name = f"calibration {record.id}"
    field = "calibration.level_within_deg"
    require_level(served.pose.theta_zz_deg, settings.calibration.level_within_deg, field=field, name=name)


def _new_refit_worker(archive: Archive, settings: Settings, clock: Clock) -> RefitWorker:
    """Return the worker that fits the archive's sightings by the settings."""
    started_at = clock.now()
    return RefitWorker(
        CameraArchive(archive, name=settings.name, site=settings.place),
        options=settings.refit,
        calibration=settings.calibration,
        cadence_s=settings.capture.cadence_s,
        clock=clock,
        now=clock.now,
        board=StatusRegistry(version=sunarc.__version__, started_at=started_at, monotonic=clock.monotonic),
        clock_error_s=settings.stated_clock_error_s,
        clock_assumed=settings.source == "folder",
    )


def _carry_out_waiting(worker: RefitWorker) -> Refit:
    """Carry out the requested refit and return it; an interrupted one has failed, and is not begun again."""
    archive, clock = worker.camera.archive, worker.clock
    refit = Refit.asked(worker.camera.name, "sunarc calibrate", at=clock.now())
    archive.refits.add(refit)
    try:
        worker.carry_out(refit, threading.Event(), lambda: None)
    except BaseException as error:
        failed = Finding("solve_failed", {"error": type(error).__name__})
        archive.refits.finish(refit.id, state="failed", finished_at=clock.now(), message="", findings=(failed,))
        raise
    return archive.refits.get(refit.id)


_ROUNDING_PX = 1e-6


def solve_again(settings: Settings, calibration_id: str) -> dict[str, Any]:
    """Solve a past calibration again, and return whether the result is the same, and its document.

    Raises
    ------
    NotFoundError : there is no such calibration, or nothing was kept with it.
    InputError : its sightings were changed or deleted since.
    """
    with open_archive(settings.archive) as archive:
        record = archive.calibrations.get(calibration_id)
        past = from_document(record.document)
        points = columns_to_sightings(
            archive.calibrations.sightings_given_to(calibration_id), site=past.site, latest=record.pose_epoch
        )
    solved = reproduce_calibration(past, points)
    separation_px = distance_px(past, solved)
    document = to_document(
        solved,
        id=f"{calibration_id}-again",
        camera=record.camera,
        state="candidate" if solved.verdict.accepted else "refused",
        created_at=record.created_at,
        valid_from=record.valid_from,
        valid_until=record.valid_until,
        pose_epoch=record.pose_epoch or "",
        software_version=sunarc.__version__,
    )
    return {
        "same": separation_px <= _ROUNDING_PX,
        "apart_px": separation_px,
        "sightings": len(points),
        "calibration": document,
    }


def reproduce_calibration(past: Calibration, points: Sightings) -> Calibration:
    """Return the calibration that the evidence of a past one leads to.

    Parameters
    ----------
    past : as it was made, or as its document states it.
    points : the sightings that it was given.

    Raises
    ------
    InputError
        Where its evidence is not whole: made by hand, or by a version with other options.
    """
    evidence = past.evidence
    try:
        solved = calibrate(
            points,
            site=past.site,
            image_size=(past.camera.width, past.camera.height),
            options=_parse_stored_options(evidence.options),
            circle=None if evidence.circle is None else ImageCircle(**_arguments_from_json(evidence.circle)),
            start=None if evidence.start is None else Camera(**_arguments_from_json(evidence.start)),
        )
    except TypeError as error:
        raise InputError(
            field="evidence", problem=f"is of another version ({error})", remedy="use the version that made it"
        ) from error
    solved = replace(solved, evidence=replace(solved.evidence, selection=evidence.selection))
    return add_pose_spread(solved, evidence.pose_spread_deg or (0.0, 0.0, 0.0))


def _parse_stored_options(stored: Mapping[str, object]) -> CalibrationOptions:
    if not stored:
        raise InputError(field="evidence.options", problem="are empty", remedy="name a calibration that a fit made")
    named = _arguments_from_json(stored)
    if named.pop("free", "all") != "all":
        raise InputError(
            field="evidence.options.free",
            problem="only the pose was fitted, with another calibration's lens, or the camera about a stated prior",
            remedy="solve the calibration that it names as its parent, or name that camera again with --start",
        )
    if "lens_prior" in named:
        raise InputError(
            field="evidence.options.lens_prior",
            problem="the fit was given a type of lens, whose file the archive does not hold",
            remedy="fit the same sightings again with that file and --lens-prior",
        )
    lens, paper = LensTolerances(**named.pop("tolerances")), PaperOptions(**named.pop("paper"))
    return CalibrationOptions(**named, tolerances=lens, paper=paper)


def _arguments_from_json(stored: Mapping[str, object]) -> dict[str, Any]:
    """Return stored JSON values as keyword arguments, with lists converted to tuples."""
    return {name: tuple(value) if isinstance(value, list) else value for name, value in stored.items()}
