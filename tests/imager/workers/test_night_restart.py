"""A night survives a restart, and a clock that was set for a moment does not end it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest
from tests.fixtures.archive import new_archive
from tests.imager.workers.test_moon import HALF
from tests.imager.workers.test_moon import frame as moon_frame
from tests.imager.workers.test_night import BEGIN, CAMERA, Bench, clear, frame_at

from sunarc.common.errors import OutsideError
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.images import ImageStore
from sunarc.imager.archive.values import CameraRecord, Event
from sunarc.imager.workers.night import night as night_module
from sunarc.lab.simulation.truth import SGP

MINUTES = (0, 20, 40, 60, 80, 100)
"""So many and so long that there is a list of warm pixels."""


def archive_in(folder: Path) -> Archive:
    folder.mkdir(exist_ok=True)
    archive = new_archive(folder)
    archive.cameras.save(CameraRecord.at(SGP, name="roof", width=CAMERA.width, height=CAMERA.height))
    return archive


@pytest.fixture
def archive(tmp_path: Path) -> Iterator[Archive]:
    made = archive_in(tmp_path)
    yield made
    made.close()


@pytest.fixture
def bench(archive: Archive) -> Bench:
    made = Bench(archive)
    made.serve(CAMERA)
    return made


def stored_stars(archive: Archive) -> list[tuple[object, ...]]:
    points = archive.sightings.find("roof", body=None)
    return sorted((point.time, point.body, point.x_px, point.y_px, point.accepted) for point in points)


def one_night(archive: Archive) -> Event:
    (event,) = archive.events.find("roof", kind="night")
    assert archive.nights.images("roof") == ()
    return event


def killed(folder: Path, *minutes: int, at_verdict: bool) -> None:
    """Look at images of a night in a process of its own, which is killed after them or at the verdict."""
    script = f"from {__name__} import look_and_die; look_and_die({str(folder)!r}, {minutes}, {at_verdict})"
    done = subprocess.run([sys.executable, "-c", script], cwd=Path(__file__).parents[3], check=False, timeout=200)
    assert done.returncode == -signal.SIGKILL


def look_and_die(folder: str, minutes: tuple[int, ...], at_verdict: bool) -> None:  # noqa: FBT001 - of a script
    """Take part in `killed`: this process does not come back."""
    bench = Bench(open_archive(Path(folder) / "sunarc.sqlite"), store=ImageStore(Path(folder) / "images"))
    for frame in clear(*minutes):
        bench.worker.look_at(frame)
    if at_verdict:
        bench.archive.sightings.add = die_after(bench.archive.sightings.add)  # type: ignore[method-assign]
        bench.worker.finish()
    os.kill(os.getpid(), signal.SIGKILL)


def die_after(store: Callable[..., int]) -> Callable[..., int]:
    """Return what stores the stars, and ends the process before their verdict."""

    def stored(points: object) -> int:
        store(points)
        os.kill(os.getpid(), signal.SIGKILL)
        return 0

    return stored


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_night_that_was_killed_twice_has_the_verdict_and_the_stars_of_one_that_was_not(tmp_path: Path) -> None:
    whole = Bench(archive_in(tmp_path / "whole"), store=ImageStore(tmp_path / "whole" / "images"))
    whole.serve(CAMERA)
    expected = whole.night(*clear(*MINUTES))
    assert expected.details["verdict"] == "clear"
    folder = tmp_path / "killed"
    serving = Bench(archive_in(folder))
    serving.serve(CAMERA)
    serving.archive.close()
    killed(folder, *MINUTES[:3], at_verdict=False)
    killed(folder, *MINUTES[3:], at_verdict=True)
    again = Bench(open_archive(folder / "sunarc.sqlite"), store=ImageStore(folder / "images"))
    again.worker.finish()
    found = one_night(again.archive)
    assert found.details == expected.details
    assert stored_stars(again.archive) == stored_stars(whole.archive)
    assert again.refits == whole.refits
    assert len(list((folder / "images").rglob("*night.jpg"))) == 1
    whole.archive.close()
    again.archive.close()


def test_the_moon_of_before_a_restart_becomes_sightings(bench: Bench) -> None:
    for slot in range(3):
        bench.worker.add_moon_exposures([moon_frame(HALF + timedelta(minutes=10 * slot), 160.0)])
    restarted = Bench(bench.archive)
    restarted.worker.look_at(replace(frame_at(0), time=HALF))
    restarted.worker.finish()
    details = one_night(bench.archive).details
    assert (details["n_moon_images"], details["n_moon_stored"]) == (3, 3)


def test_a_night_whose_images_were_kept_is_judged_by_day_after_a_restart(bench: Bench) -> None:
    for frame in clear():
        bench.worker.look_at(frame)
    restarted = Bench(bench.archive, zenith_deg=60.0, passes_s=40.0)
    stop = threading.Event()

    def heartbeat() -> None:
        if bench.archive.events.find("roof", kind="night"):
            stop.set()

    restarted.worker.run(stop, heartbeat)
    assert one_night(bench.archive).details["n_images"] == 3


def test_images_that_end_the_process_each_time_are_given_up(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    for frame in clear(0):
        bench.worker.look_at(frame)

    def fail(*_: object) -> None:
        raise RuntimeError("of the test")

    with monkeypatch.context() as patched:
        patched.setattr(night_module, "match_views", fail)
        for _ in range(5):
            restarted = Bench(bench.archive)
            with pytest.raises(RuntimeError):
                restarted.worker.finish()
            assert bench.archive.nights.images("roof")
    last = Bench(bench.archive)
    last.worker.finish()
    details = one_night(bench.archive).details
    assert (details["verdict"], details["findings"][0]["code"]) == ("unusable", "night_given_up")


def test_a_database_that_refuses_an_image_does_not_end_the_night(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OutsideError("cannot use the database: disk is full")

    with monkeypatch.context() as patched:
        patched.setattr(bench.archive.nights, "add_image", full)
        for frame in clear():
            bench.worker.look_at(frame)
    bench.worker.finish()
    assert one_night(bench.archive).details["n_images"] == 3


def test_a_damaged_image_is_left_out(bench: Bench) -> None:
    for frame in clear():
        bench.worker.look_at(frame)
    first, *_ = bench.archive.nights.images("roof")
    bench.archive.nights.add_image("roof", replace(first, measured=first.measured[:99]), keep_since=first.time)
    restarted = Bench(bench.archive)
    restarted.worker.finish()
    assert one_night(bench.archive).details["n_images"] == 2


def test_the_archive_keeps_as_many_images_of_a_night_as_the_worker(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(night_module, "_MOST_IMAGES", 2)
    for frame in clear():
        bench.worker.look_at(frame)
    assert [image.time for image in bench.archive.nights.images("roof")] == [frame_at(m).time for m in (40, 80)]


@pytest.mark.parametrize(("trusted", "lasts_s", "ends"), [(True, 30, False), (False, 600, False), (True, 90, True)])
def test_a_sun_that_is_back_for_a_moment_does_not_end_the_night(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, *, trusted: bool, lasts_s: int, ends: bool
) -> None:
    """A clock that is set by hours and back shows a sun that is not there."""
    for frame in clear(0):
        bench.worker.look_at(frame)
    monkeypatch.setattr(night_module, "_POLL_S", 0.0)
    bench.trusted, bench.passes_s = trusted, 5.0
    stop, looks = threading.Event(), 0

    def heartbeat() -> None:
        nonlocal looks
        looks += 1
        bench.zenith_deg = 60.0 if 3 < looks <= 3 + lasts_s / bench.passes_s else 120.0
        if looks > 6 + lasts_s / bench.passes_s:
            stop.set()

    bench.worker.run(stop, heartbeat)
    assert (len(bench.archive.events.find("roof", kind="night")) == 1) == ends
    assert (bench.archive.nights.images("roof") == ()) == ends


def test_a_frame_that_a_clock_of_another_day_dates_neither_ends_the_night_nor_joins_it(bench: Bench) -> None:
    first, second, third = clear()
    bench.worker.look_at(first)
    bench.clock_error_s = 50_400.0
    bench.worker.look_at(replace(second, time=second.time + timedelta(hours=14)))
    bench.clock_error_s = 0.01
    bench.worker.look_at(third)
    assert bench.archive.events.find("roof", kind="night") == ()
    bench.worker.finish()
    assert one_night(bench.archive).details["n_images"] == 2


def test_images_from_before_the_clock_was_right_are_no_night_of_another_date(bench: Bench) -> None:
    bench.clock_error_s = 1e9
    bench.worker.look_at(replace(frame_at(0), time=BEGIN - timedelta(days=400)))
    bench.clock_error_s = 0.01
    for frame in clear(40, 80):
        bench.worker.look_at(frame)
    bench.worker.finish()
    details = one_night(bench.archive).details
    assert (details["date"], details["n_images"]) == ("2013-05-12", 2)


def test_stars_carry_the_bound_that_the_clock_had_when_they_were_taken(bench: Bench) -> None:
    bench.clock_error_s = 1.5
    bench.worker.look_at(frame_at(0))
    bench.clock_error_s = 0.01
    for frame in clear(40, 80):
        bench.worker.look_at(frame)
    Bench(bench.archive).worker.finish()
    bounds = {point.time: point.clock_error_s for point in bench.archive.sightings.find("roof", body=None)}
    assert bounds == {frame_at(0).time: 1.5, frame_at(40).time: 0.01, frame_at(80).time: 0.01}
