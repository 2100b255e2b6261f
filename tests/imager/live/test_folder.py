"""A folder that grows: each image is looked at once, by its own time, whatever happens to the folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from datetime import UTC, datetime, timedelta
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from tests.imager.live.followed import Followed, serve_calibration_of
from tests.imager.live.sky_pictures import Lens, jpeg, picture, sun_at
from tests.imager.live.test_snapshots import bomb

from sunarc.common.findings import Finding
from sunarc.imager.archive.values import SunPoint
from sunarc.imaging.preview import decoded
from sunarc.sources import image_files

MORNING = datetime(2025, 5, 13, 15, 0, tzinfo=UTC)
LENS = Lens()
NOBODY = 65534


def shot(time: datetime, *, seed: int = 0, cloud: bool = False, lens: Lens = LENS) -> bytes:
    rng = np.random.default_rng([seed, int(time.timestamp())])
    return jpeg(picture(time, lens, rng, cloud=cloud))


def allsky(time: datetime) -> str:
    return f"{time:%Y%m%d}/image-{time:%Y%m%d%H%M%S}.jpg"


@pytest.fixture
def followed(tmp_path: Path) -> Iterator[Followed]:
    made = Followed(tmp_path, MORNING)
    made.turn()
    yield made
    made.close()


def take(followed: Followed, n: int, *, every_s: float = 60.0, name: object = allsky) -> list[datetime]:
    """Have so many images come, one every so often."""
    times = []
    for _ in range(n):
        time = followed.clock.now().replace(microsecond=0)
        followed.write(name(time), shot(time))  # type: ignore[operator]
        times.append(time)
        followed.turn()
        followed.clock.advance(every_s - 3.0)
    return times


def test_images_are_taken_as_they_come_and_once(followed: Followed, tmp_path: Path) -> None:
    times = take(followed, 3)
    points = followed.points()
    assert [point.time for point in points] == times
    assert {(point.verdict, point.clock_error_s, point.ingest_pass) for point in points} == {("clear", 1.0, 1)}
    for point in points:
        assert (point.x_px, point.y_px) == pytest.approx(LENS.pixel(*sun_at(point.time)), abs=0.5)
    assert followed.service.board.snapshot().last_frame_at == times[-1]
    assert followed.worker.newest_picture == followed.root / allsky(times[-1])
    assert followed.codes() == set()
    assert not followed.service.watch.host_dates  # a step of the clock is found in the sky alone
    before = followed.service.archive.seen_files.newest("roof", limit=9)
    followed.turn()
    followed.close()
    again = Followed(tmp_path, followed.clock.now())
    again.turn()
    assert [point.time for point in again.points()] == times
    assert again.service.archive.seen_files.newest("roof", limit=9) == before
    again.close()


def test_pictures_are_turned_upright_where_that_is_set(tmp_path: Path) -> None:
    followed = Followed(tmp_path, MORNING, follow_exif=True)
    followed.turn()
    time = followed.clock.now().replace(microsecond=0)
    stored = BytesIO()
    exif = Image.Exif()
    exif[0x0112] = 3
    Image.open(BytesIO(shot(time))).rotate(180).save(stored, format="JPEG", quality=95, exif=exif)
    followed.write(allsky(time), stored.getvalue())
    followed.turn()
    (point,) = followed.points()
    assert point.verdict == "clear"
    assert (point.x_px, point.y_px) == pytest.approx(LENS.pixel(*sun_at(time)), abs=0.5)
    followed.close()


def test_what_came_and_is_not_stored_waits(followed: Followed, monkeypatch: pytest.MonkeyPatch) -> None:
    waiting, sightings = [followed.worker.n_waiting], followed.worker.camera.archive.sightings
    store = sightings.replace

    def replace(points: list[SunPoint], *, first_epoch: str) -> dict[str, Finding]:
        waiting.append(followed.worker.n_waiting)
        return store(points, first_epoch=first_epoch)

    monkeypatch.setattr(sightings, "replace", replace)
    for n in range(3):
        followed.write(allsky(MORNING - timedelta(minutes=n)), shot(MORNING - timedelta(minutes=n)))
    followed.turn()
    assert [*waiting, followed.worker.n_waiting] == [0, 3, 2, 1, 0]


def test_the_last_sighting_is_shown_whatever_comes_late_and_without_sun(followed: Followed) -> None:
    assert followed.service.board.snapshot().last_sighting_at is None
    first, last = take(followed, 2)
    late, cloudy = first + timedelta(seconds=20), followed.clock.now().replace(microsecond=0)
    followed.write(allsky(late), shot(late))
    followed.write(allsky(cloudy), shot(cloudy, cloud=True))
    followed.turn()
    assert len(followed.points()) == 4
    assert followed.verdicts()[-1] != "clear"
    assert followed.service.board.snapshot().last_sighting_at == last


def test_a_half_written_file_is_awaited_and_a_truncated_one_left_out_in_the_end(followed: Followed) -> None:
    time = followed.clock.now()
    content = shot(time)
    path = followed.write(allsky(time), content[: len(content) // 2])
    followed.turn()
    assert followed.points() == ()
    followed.write(allsky(time), content)
    for _ in range(2):
        followed.clock.advance(31.0)
        followed.turn()
    assert followed.verdicts() == ["clear"]
    later = followed.clock.now()
    path = followed.write(allsky(later), shot(later)[:3000])
    for _ in range(6):
        followed.clock.advance(31.0)
        followed.turn()
    assert followed.service.archive.seen_files.refused("roof") == {"file_truncated": 1}
    path.write_bytes(shot(later))
    followed.turn()
    assert followed.verdicts() == ["clear", "clear"]


def test_what_is_in_the_folder_at_the_start_is_taken_too(tmp_path: Path) -> None:
    followed = Followed(tmp_path, MORNING)
    for minutes in (90, 60, 30, 1):
        time = MORNING - timedelta(minutes=minutes)
        path = followed.write(allsky(time), shot(time))
        os.utime(path, (time.timestamp(), time.timestamp()))
    followed.turn()
    assert [point.time for point in followed.points()] == [MORNING - timedelta(minutes=n) for n in (90, 60, 30, 1)]
    followed.close()


def test_an_upload_after_six_hours_is_taken_and_its_day_judged_again(followed: Followed) -> None:
    take(followed, 4, every_s=300.0)
    followed.clock.advance(86_400.0)
    followed.turn()
    noticed = list[datetime]()
    followed.worker.images.notice = lambda time, _: noticed.append(time)
    followed.service.judge_completed_days()
    judged = followed.service.archive.days.find("roof")
    for n in range(30):
        time = MORNING + timedelta(minutes=30 + 5 * n)
        followed.write(allsky(time), shot(time))
    followed.turn()
    assert len(followed.points()) == 34
    followed.service.judge_completed_days()
    assert followed.service.archive.days.find("roof") == judged  # more may come
    followed.clock.advance(700.0)
    followed.service.judge_completed_days()
    (day,) = followed.service.archive.days.find("roof")
    assert (day.n_observed, day.n) == (34, 34)
    earlier = MORNING + timedelta(minutes=2)
    followed.write(allsky(earlier), shot(earlier))
    followed.turn()
    assert len(followed.points()) == 35
    assert (len(noticed), noticed) == (30, sorted(noticed))  # in another order the sun would seem to go back


def test_a_move_that_late_images_alone_show_is_noticed_and_dated_by_them(followed: Followed) -> None:
    take(followed, 4, every_s=300.0)
    serve_calibration_of(followed.service, LENS, MORNING - timedelta(hours=2))
    turned = Lens(turn_deg=LENS.turn_deg + 3.0)
    times = [MORNING + timedelta(minutes=40 + 10 * n) for n in range(14)]
    followed.clock.advance((times[-1] - followed.clock.now()).total_seconds())
    order = np.random.default_rng(1).permutation(13).tolist()
    for time in (times[-1], *(times[number] for number in order)):  # the last one comes first
        followed.write(allsky(time), shot(time, lens=LENS if time < times[4] else turned))
        followed.turn()
        followed.service.watch.process_next()
    assert len(followed.service.archive.epochs.find("roof")) == 1  # more may come
    followed.clock.advance(600.0)
    followed.turn()
    followed.service.watch.process_next()
    began, moved = followed.service.archive.epochs.find("roof")
    assert (began.ended_at, moved.started_at, moved.reason) == (times[4], times[4], "bump")
    assert {point.pose_epoch for point in followed.points() if point.time >= times[4]} == {moved.id}
    assert all(point.accepted for point in followed.points())


def test_a_copy_is_known_by_its_content_and_a_picture_that_comes_again_is_frozen(followed: Followed) -> None:
    time = followed.clock.now()
    followed.write(allsky(time), shot(time))
    followed.turn()
    followed.write(f"copies/image-{time:%Y%m%d%H%M%S}_2.jpg", shot(time))
    followed.write("latest.jpg", shot(time))
    followed.turn()
    assert followed.verdicts() == ["clear"]
    for n in range(1, 4):
        later = time + timedelta(minutes=n)
        followed.clock.advance(57.0)
        followed.write(allsky(later), shot(time))
        followed.turn()
    assert followed.verdicts() == ["clear", "frozen", "frozen", "frozen"]
    assert "camera_frozen" in followed.codes()
    take(followed, 1)
    assert "camera_frozen" not in followed.codes()


def test_exposures_of_one_time_are_one_sighting_in_whatever_order_they_come(followed: Followed) -> None:
    time = followed.clock.now()
    rng = np.random.default_rng(4)
    for exposure_us, plateau_deg in ((4000, 4.0), (1000, 2.6), (250, 1.5)):
        image = picture(time, LENS, rng, plateau_deg=plateau_deg)
        followed.write(f"{time:%Y%m%dT%H%M%SZ}_{exposure_us}us.jpg", jpeg(image))
        followed.turn()
        followed.clock.advance(25.0)  # the other exposures of a stack are waited for
        followed.turn()
    points = followed.points()
    assert sorted(point.verdict for point in points) == ["clear", "in_stack", "in_stack"]
    assert {point.exposure_us for point in points} == {4000.0, 1000.0, 250.0}


def test_the_silence_of_a_folder_is_told_by_day(followed: Followed) -> None:
    take(followed, 2)
    for _ in range(11):
        followed.clock.advance(60.0)
        followed.turn()
    (reason,) = [one for one in followed.service.board.snapshot().reasons if one.code == "no_new_image"]
    assert reason.data["file"] == allsky(MORNING + timedelta(seconds=63))
    take(followed, 1)
    assert "no_new_image" not in followed.codes()
    followed.clock.advance(12.0 * 3600.0)
    followed.turn()
    assert "no_new_image" not in followed.codes()


def test_a_folder_that_vanishes_comes_back_with_all_that_was_written_meanwhile(followed: Followed) -> None:
    times = take(followed, 2)
    away = followed.root.rename(followed.root.with_name("away"))
    followed.worker.note_names([""])  # as the folder itself is reported
    followed.turn()
    assert "folder_missing" in followed.codes()
    assert followed.service.board.snapshot().health == "not_ready"
    time = followed.clock.now().replace(microsecond=0)
    path = away / allsky(time)
    path.write_bytes(shot(time))
    os.utime(path, (time.timestamp(), time.timestamp()))
    away.rename(followed.root)
    followed.turn()
    assert [point.time for point in followed.points()] == [*times, time]
    assert "folder_missing" not in followed.codes()
    assert followed.service.board.snapshot().health == "ready"


@pytest.mark.parametrize(
    ("names", "options", "code"),
    [
        ("image-{:%Y%m%d%H%M%S}.jpg", {"utc_offset": None}, "images_without_zone"),
        ("snapshot{:%S%M}.jpg", {}, "images_without_time"),
        ("image-{:%Y%m%d%H%M%S}.jpg", {"utc_offset": "-1"}, "images_in_future"),
        ("image-{:%Y%m%d%H%M%S}.jpg", {"utc_offset": "2"}, "image_times_offset"),
    ],
)
def test_what_is_wrong_with_most_images_is_a_condition(
    tmp_path: Path, names: str, options: dict[str, object], code: str
) -> None:
    followed = Followed(tmp_path, MORNING, **options)
    followed.turn()
    take(followed, 8, name=names.format)
    assert code in followed.codes()
    followed.close()


def test_images_of_another_size_and_of_another_camera_are_left_out_and_the_right_ones_used(followed: Followed) -> None:
    take(followed, 6, name="ccd1_{:%Y%m%d_%H%M%S}.jpg".format)
    take(followed, 3, name="ccd2_{:%Y%m%d_%H%M%S}.jpg".format)
    assert len(followed.points()) == 6
    assert "images_of_two_cameras" in followed.codes()
    for n in range(9):
        time = followed.clock.now()
        content = shot(time, lens=Lens(size=200, focal_px=60.0, x=99.0, y=99.0)) if n % 2 else shot(time)
        followed.write(f"ccd1_{time:%Y%m%d_%H%M%S}.jpg", content)
        followed.turn()
        followed.clock.advance(57.0)
    assert followed.verdicts() == ["clear"] * (6 + 5)
    assert followed.service.archive.seen_files.refused("roof") == {"file_other_camera": 3, "file_size_differs": 4}
    assert "images_of_another_size" in followed.codes()


def test_a_picture_that_is_resized_is_the_cameras_with_another_lens_from_then_on(followed: Followed) -> None:
    take(followed, 6)
    serve_calibration_of(followed.service, LENS, MORNING.replace(day=12))
    archive, small = followed.service.archive, Lens(size=200, focal_px=60.0, x=99.0, y=99.0)
    first = followed.clock.now().replace(microsecond=0)
    for _ in range(14):
        time = followed.clock.now().replace(microsecond=0)
        followed.write(allsky(time), shot(time, lens=small))
        followed.turn()
        followed.clock.advance(57.0)
    record = archive.cameras.get("roof")
    assert record is not None
    assert record.image_size == (small.size, small.size)
    assert archive.calibrations.current("roof") is None
    former, present = archive.epochs.find("roof")
    assert (former.ended_at, present.started_at, present.reason) == (first, first, "lens")
    (event,) = archive.events.find("roof", kind="picture_resized")
    assert (event.time, event.details["width"], event.details["width_before"]) == (first, small.size, LENS.size)
    points = followed.points()
    assert [point.time for point in points[6:]] == [first + n * timedelta(seconds=60) for n in range(14)]
    for point in points[6:]:
        assert (point.x_px, point.y_px) == pytest.approx(small.pixel(*sun_at(point.time)), abs=0.5)
    assert archive.seen_files.refused("roof") == {}
    assert "images_of_another_size" not in followed.codes()


def test_an_image_that_is_refused_for_its_size_is_not_decoded(
    followed: Followed, monkeypatch: pytest.MonkeyPatch
) -> None:
    shapes = set[tuple[int, ...]]()

    def recorded(encoded: bytes) -> NDArray[Any] | None:
        image = decoded(encoded)
        shapes.add(() if image is None else image.shape[:2])
        return image

    monkeypatch.setattr(image_files, "decoded", recorded)
    take(followed, 1)
    time = followed.clock.now()
    followed.write(allsky(time), shot(time, lens=Lens(size=200, focal_px=60.0, x=99.0, y=99.0)))
    followed.turn()
    assert followed.service.archive.seen_files.refused("roof") == {"file_size_differs": 1}
    assert shapes == {(LENS.size, LENS.size)}


@pytest.fixture
def as_nobody(tmp_path: Path) -> Iterator[Callable[[], AbstractContextManager[None]]]:
    """Return what takes this process's rights away meanwhile, in a folder that nobody owns."""
    if os.geteuid() != 0:
        pytest.skip("root alone can try what another user may not read")
    above = [one for one in (tmp_path, *tmp_path.parents) if not one.stat().st_mode & 0o001]
    modes = {one: one.stat().st_mode for one in above}
    for one in above:
        one.chmod(modes[one] | 0o011)

    @contextmanager
    def as_nobody() -> Iterator[None]:
        for one in (tmp_path, *tmp_path.rglob("*")):
            if one.stat().st_uid == 0 and "images" not in one.parts:
                os.chown(one, NOBODY, NOBODY)
        os.setegid(NOBODY)
        os.seteuid(NOBODY)
        try:
            yield
        finally:
            os.seteuid(0)
            os.setegid(0)

    yield as_nobody
    for one, mode in modes.items():
        one.chmod(mode)


def test_what_may_not_be_read_is_said_and_taken_once_it_may(
    as_nobody: Callable[[], AbstractContextManager[None]], tmp_path: Path
) -> None:
    followed = Followed(tmp_path, MORNING + timedelta(minutes=9))
    times = [MORNING + timedelta(minutes=n) for n in range(6)]
    paths = [followed.write(f"day{n // 3}/image-{time:%Y%m%d%H%M%S}.jpg", shot(time)) for n, time in enumerate(times)]
    folders = [followed.root / name for name in ("day0", "day1")]
    for folder in folders:
        os.utime(folder, (MORNING.timestamp(), MORNING.timestamp()))
    (followed.root / "not written for long").mkdir(mode=0o700)
    os.utime(followed.root / "not written for long", (0.0, 0.0))

    def turned(*modes: tuple[Path, int]) -> tuple[set[str], int]:
        for path, mode in modes:
            path.chmod(mode)
        with as_nobody():
            followed.clock.advance(31.0)
            followed.turn()
        return followed.codes() & {"folder_not_permitted", "images_left_out"}, len(followed.points())

    assert turned((followed.root, 0o700)) == ({"folder_not_permitted"}, 0)
    assert followed.service.board.snapshot().health == "not_ready"
    assert turned((followed.root, 0o755), (folders[0], 0o700)) == ({"folder_not_permitted"}, 3)
    (reason,) = [one for one in followed.service.board.snapshot().reasons if one.code == "folder_not_permitted"]
    assert reason.data["folder"] == str(folders[0])
    assert turned((folders[0], 0o744)) == ({"folder_not_permitted"}, 3)  # listed, and not entered
    assert turned((folders[0], 0o755), *((path, 0o600) for path in paths[:3])) == ({"images_left_out"}, 3)
    assert turned(*((path, 0o644) for path in paths[:3])) == (set(), 6)
    followed.close()


def test_a_live_image_is_taken_before_the_hundreds_that_came_with_it(followed: Followed) -> None:
    """They are dated a few at a time; what is no image costs the test nothing."""
    for n in range(200):
        followed.write(f"old/image-20240513{n // 60:02d}{n % 60:02d}00.jpg", b"%d" % n)
    followed.worker.list_new()
    followed.clock.advance(1.5)
    assert followed.worker.work()
    live = followed.clock.now().replace(microsecond=0)
    followed.write(allsky(live), shot(live))
    followed.worker.list_new()
    followed.clock.advance(1.5)
    followed.worker.work()
    assert [point.time for point in followed.points()] == [live]


def test_html_in_a_picture_and_a_huge_one_are_left_out(followed: Followed) -> None:
    take(followed, 1)
    for n, content in enumerate([b"<html>401</html>", b"", shot(MORNING)[:2]]):
        followed.clock.advance(60.0)
        followed.write(f"image-2025051315{n:02d}30.jpg", content)
        for _ in range(6):
            followed.clock.advance(31.0)
            followed.turn()
    followed.write("image-20250513150330.png", bomb(60_000))
    followed.turn()
    assert followed.verdicts() == ["clear"]
    refused = followed.service.archive.seen_files.refused("roof")
    assert (sum(refused.values()), refused["file_too_many_pixels"]) == (4, 1)
    assert "images_left_out" in followed.codes()


def test_the_folder_is_never_written(followed: Followed) -> None:
    take(followed, 2)
    followed.root.chmod(0o555)
    before = sorted(path.name for path in followed.root.rglob("*"))
    followed.turn()
    assert sorted(path.name for path in followed.root.rglob("*")) == before
    followed.root.chmod(0o755)


@pytest.mark.parametrize(
    ("late_s", "codes"), [(300.0, {"image_times_late"}), (60.0, set()), (3600.0, {"image_times_offset"})]
)
def test_images_that_always_come_late_are_said_before_the_first_calibration(
    followed: Followed, late_s: float, codes: set[str]
) -> None:
    followed.turn()
    for _ in range(9):
        time = followed.clock.now().replace(microsecond=0) - timedelta(seconds=late_s)
        followed.write(allsky(time), shot(time))
        followed.turn()
        followed.clock.advance(57.0)
    assert followed.codes() == codes


def test_times_of_a_simulation_are_not_compared_with_the_hosts_clock(tmp_path: Path) -> None:
    followed = Followed(tmp_path, MORNING + timedelta(days=4000), speed=20.0)
    followed.turn()
    for n in range(9):
        time = MORNING + timedelta(minutes=n)
        followed.write(allsky(time), shot(time))
        followed.turn()
        followed.clock.advance(3.0)
    assert len(followed.points()) == 9
    assert followed.codes() == set()
    followed.close()


def test_dates_that_no_image_has_are_left_out_and_the_next_image_is_taken(followed: Followed) -> None:
    """Names, and times of change, that no date or only one of the year 1 can state."""
    followed.turn()
    followed.write("image-00010101000000.jpg", shot(MORNING))
    followed.write("image-99991231235959.jpg", shot(MORNING, seed=1))
    followed.write("notime.jpg", b"PRD=MOBOTIX\nDAT=2025-99-99\nTIM=23:59:59\nTZN=GMT+1\n")
    for n, changed_s in enumerate((-(2**40), 2**40)):
        path = followed.write(f"20250513_15000{n}.jpg", shot(MORNING, seed=2 + n))
        with suppress(OSError, OverflowError):  # the file system may not keep it
            os.utime(path, (changed_s, changed_s))
    followed.turn()
    followed.turn()
    assert len(followed.points()) == 2
    assert followed.codes() == {"images_without_time"}


YEARS_S = 3.0 * 366.0 * 86_400.0


def test_images_ahead_of_a_clock_that_is_then_set_are_used(tmp_path: Path) -> None:
    followed = Followed(tmp_path, MORNING - timedelta(seconds=YEARS_S))
    followed.turn()
    for n in range(30):
        time = MORNING + timedelta(minutes=n)
        followed.write(allsky(time), shot(time))
        followed.turn()
        followed.clock.advance(57.0)
    assert followed.service.archive.seen_files.refused("roof") == {"file_time_future": 30}
    assert followed.points() == ()
    followed.clock.step(YEARS_S)
    followed.turn()
    assert (len(followed.points()), followed.service.archive.seen_files.refused("roof")) == (30, {})
    followed.close()


@pytest.mark.parametrize(("behind_s", "n"), [(YEARS_S, 30), (7200.0, 0)])
def test_a_restart_dates_images_again_that_were_ahead_of_a_clock_years_behind(
    behind_s: float, n: int, tmp_path: Path
) -> None:
    """Hours alone are those of a wrong zone, which pass without any clock being set."""
    followed = Followed(tmp_path, MORNING - timedelta(seconds=behind_s))
    followed.turn()
    for minute in range(30):
        time = MORNING + timedelta(minutes=minute)
        followed.write(allsky(time), shot(time))
    followed.turn()
    assert followed.service.archive.seen_files.refused("roof") == {"file_time_future": 30}
    followed.close()
    again = Followed(tmp_path, MORNING + timedelta(days=1))
    again.turn()
    assert len(again.points()) == n
    assert sum(again.service.archive.seen_files.refused("roof").values()) == 30 - n
    again.close()


def test_a_wrong_zone_is_not_used_once_its_time_has_passed(tmp_path: Path) -> None:
    followed = Followed(tmp_path, MORNING, utc_offset="-1")
    followed.turn()
    take(followed, 3)
    followed.clock.advance(7200.0)
    followed.turn()
    assert followed.points() == ()
    followed.close()


def test_a_zone_that_is_given_at_last_dates_the_images_that_were_left_out(tmp_path: Path) -> None:
    followed = Followed(tmp_path, MORNING, utc_offset=None)
    followed.turn()
    take(followed, 5)
    assert followed.points() == ()
    followed.close()
    again = Followed(tmp_path, MORNING + timedelta(hours=3))
    again.turn()
    assert again.verdicts() == ["clear"] * 5
    again.close()
