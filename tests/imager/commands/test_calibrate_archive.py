"""The archive's sightings to a stored calibration; the solve itself is another's test."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.fixtures.archive import make_empty
from tests.fixtures.calibration import SGP, small_camera, stated_calibration
from tests.fixtures.settings import new_settings

from sunarc.calibration.model.result import Calibration, Verdict
from sunarc.common.errors import InputError, OutsideError, SchemaError
from sunarc.common.findings import Finding, uncoded
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.database.state_folder import lock_state
from sunarc.imager.archive.values import CameraRecord, SunPoint
from sunarc.imager.commands import calibrate_archive as module
from sunarc.imager.commands.calibrate_archive import calibrate_archive
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.settings.model import Settings
from sunarc.imager.workers.calibrating.refit import RefitWorker
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_directions

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

MORNING = datetime(2013, 5, 13, 14, 0, tzinfo=UTC)
NOW = datetime(2014, 1, 1, tzinfo=UTC)
CAMERA = small_camera()
GOOD = stated_calibration(CAMERA)
STATED_PX = 0.5


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    """Return settings whose archive has forty sightings in image files, 1 px off each, that state 0.5 px."""
    settings = new_settings(tmp_path)
    make_empty(settings.database)
    with open_archive(settings.database) as archive:
        archive.cameras.save(CameraRecord.at(SGP, name="roof", width=CAMERA.width, height=CAMERA.height))
        epoch = archive.epochs.at("roof", MORNING, reason="first image").id
        times = [MORNING + timedelta(minutes=10 * n) for n in range(40)]
        pixels = project(CAMERA, sun_directions([time.timestamp() for time in times], SGP)).tolist()
        archive.sightings.add(
            SunPoint(camera="roof", pose_epoch=epoch, time=time, method="paper", accepted=True, verdict="clear",
                     x_px=x + 1.0, y_px=y, sigma_px=STATED_PX, file=f"{n}.jpg", ingest_pass=2)
            for n, (time, (x, y)) in enumerate(zip(times, pixels, strict=True))
        )  # fmt: skip
    return settings


@pytest.fixture
def solve(monkeypatch: pytest.MonkeyPatch) -> Callable[[Calibration], None]:
    """Let the refit's solve answer with a calibration that is known."""

    def answer(calibration: Calibration) -> None:
        known = partial(RefitWorker, solve=lambda *_, **__: calibration, search=lambda *_, **__: ())
        monkeypatch.setattr(module, "RefitWorker", known)

    return answer


def test_an_accepted_fit_is_stored_and_served(settings: Settings, solve: Callable[[Calibration], None]) -> None:
    solve(GOOD)
    refit, document = calibrate_archive(settings, clock=VirtualClock(NOW))
    assert refit.state == "accepted"
    assert document is not None
    with open_archive(settings.database) as archive:
        current = archive.calibrations.current("roof")
        assert current is not None
        assert (current.id, current.valid_from) == (document["id"], MORNING)
        assert len(archive.calibrations.sightings_given_to(current.id).ids) == 40
        assert [one.state for one in archive.refits.find("roof")] == ["accepted"]


def test_the_scatter_about_an_accepted_fit_becomes_the_stated_sigma(
    settings: Settings, solve: Callable[[Calibration], None]
) -> None:
    solve(GOOD)
    _, document = calibrate_archive(settings, clock=VirtualClock(NOW))
    assert document is not None
    with open_archive(settings.database) as archive:
        learned = {point.sigma_px for point in archive.sightings.find("roof")}
        assert set(archive.calibrations.sightings_given_to(document["id"]).sigma_px.tolist()) == {STATED_PX}
    assert len(learned) == 1
    assert 0.6 < float(learned.pop() or 0.0) < 1.1


UNDETERMINED = replace(
    GOOD,
    verdict=Verdict(accepted=False, findings=(Finding("direction_sigma_too_large", {"sigma_deg": 2.0}),)),
    covariance=9.0 * GOOD.covariance,
)


@pytest.mark.parametrize("asked", [False, True])
def test_what_lacks_days_is_kept_where_asked_and_gives_way_to_an_accepted_fit(
    settings: Settings, solve: Callable[[Calibration], None], *, asked: bool
) -> None:
    solve(UNDETERMINED)
    refit, document = calibrate_archive(settings, clock=VirtualClock(NOW), keep_provisional=asked)
    assert refit.state == ("marginal" if asked else "refused")
    assert document is not None
    with open_archive(settings.database) as archive:
        assert archive.calibrations.current("roof") is None
        assert archive.calibrations.get(document["id"]).state == ("candidate" if asked else "refused")
        if not asked:
            return
        archive.calibrations.reinstate(document["id"], at=MORNING, reason="the first pictures")
        served = archive.calibrations.current_model("roof")
        assert served is not None
        assert served.sigma_limit_deg == settings.calibration.max_sky_deg
    solve(GOOD)
    refit, better = calibrate_archive(settings, clock=VirtualClock(NOW))
    assert refit.state == "accepted"
    assert better is not None
    with open_archive(settings.database) as archive:
        current = archive.calibrations.current("roof")
        assert current is not None
        assert current.id == better["id"]


def test_a_refused_fit_is_stored_served_to_nobody_and_teaches_nothing(
    settings: Settings, solve: Callable[[Calibration], None]
) -> None:
    solve(replace(GOOD, verdict=Verdict(accepted=False, findings=(Finding("mirroring_ambiguous"),))))
    refit, document = calibrate_archive(settings, clock=VirtualClock(NOW))
    assert (refit.state, [one.code for one in refit.findings]) == ("refused", ["mirroring_ambiguous"])
    assert document is not None
    assert document["state"] == "refused"
    with open_archive(settings.database) as archive:
        assert archive.calibrations.current("roof") is None
        assert {point.sigma_px for point in archive.sightings.find("roof")} == {STATED_PX}


def test_without_sightings_there_is_no_calibration(settings: Settings) -> None:
    with open_archive(settings.database) as archive:
        archive.sightings.exclude("roof", uncoded("test"), since=MORNING)
    refit, document = calibrate_archive(settings, clock=VirtualClock(NOW))
    assert document is None
    assert (refit.state, [one.code for one in refit.findings]) == ("failed", ["no_accepted_sightings"])


def test_an_interrupted_fit_has_failed_and_is_not_begun_again(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> Calibration:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "RefitWorker", partial(RefitWorker, solve=interrupted))
    with pytest.raises(KeyboardInterrupt):
        calibrate_archive(settings, clock=VirtualClock(NOW))
    with open_archive(settings.database) as archive:
        assert [one.state for one in archive.refits.find("roof")] == ["failed"]
        assert archive.refits.find("roof", unfinished=True) == ()


def test_a_state_folder_that_a_service_uses_is_refused(settings: Settings) -> None:
    held, done = threading.Event(), threading.Event()

    def hold() -> None:
        with lock_state(settings.state):
            held.set()
            done.wait(30.0)

    holder = threading.Thread(target=hold)
    holder.start()
    try:
        assert held.wait(30.0)
        with pytest.raises(OutsideError):
            calibrate_archive(settings, clock=VirtualClock(NOW))
    finally:
        done.set()
        holder.join()


def test_an_archive_without_images_names_what_fills_it(tmp_path: Path) -> None:
    settings = new_settings(tmp_path)
    with pytest.raises(SchemaError, match="sunarc ingest"):
        calibrate_archive(settings, clock=VirtualClock(NOW))
    make_empty(settings.database)
    with pytest.raises(InputError, match="sunarc ingest"):
        calibrate_archive(settings, clock=VirtualClock(NOW))


def command(settings: Settings, folder: Path) -> tuple[str, ...]:
    config = folder / "sunarc.toml"
    config.write_text(
        f'name = "roof"\nstate = "{settings.state}"\n'
        f"[site]\nlatitude = {SGP.latitude}\nlongitude = {SGP.longitude}\naltitude = {SGP.altitude}\n"
    )
    return "calibrate", "--config", str(config)


def test_the_command_prints_what_was_stored(
    settings: Settings, sunarc: Sunarc, solve: Callable[[Calibration], None], tmp_path: Path
) -> None:
    solve(GOOD)
    answer = sunarc(*command(settings, tmp_path))
    assert answer.code == 0, answer.err
    with open_archive(settings.database) as archive:
        current: Any = archive.calibrations.current("roof")
    assert current.id in answer.out


@pytest.mark.parametrize("more", [("--latitude", "3"), ("--image-size", "9,9"), ("--pose-only",), ("--start", "a")])
def test_options_of_a_file_are_refused_without_one(
    settings: Settings, sunarc: Sunarc, tmp_path: Path, more: tuple[str, ...]
) -> None:
    assert sunarc(*command(settings, tmp_path), *more).code == 2
