"""Images of the night in an archive: their stars are named by the calibration of their epoch, once, and fitted."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tests.archives.in_process import InProcess
from tests.fixtures.calibrations import SITE, chosen_calibration
from tests.public.test_star_files import CAMERA, SIZE, night_image

from sunarc.archives import nights as stars_module
from sunarc.archives.fit import (
    CameraSightings,
    Final,
    StarFitInput,
    choose_better_calibrations,
    fit_poses,
    make_epoch_document,
    starry_analysis,
)
from sunarc.archives.ledger import Ledger
from sunarc.archives.nights import CameraNights, NightsLooked, collect_nights, name_stars, star_points
from sunarc.archives.passes import Passes
from sunarc.archives.states import ArchiveCamera, Epoch, State
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.findings import Finding
from sunarc.common.utc import DAY_S
from sunarc.optics.forward import project
from sunarc.sky.night import STAR, body_directions
from sunarc.sky.sun import sun_directions
from sunarc.sources.index import ArchiveImage, CameraImages, CameraPlan, Selector
from sunarc.sources.look import Chunk, NamedStars, pack_mask
from sunarc.stars.views import star_view

TIMES = ("20260313_060000", "20260313_064000", "20260313_072000")
LATE_S = 3600.0
PLAN = CameraPlan(name="roof", site=SITE, selector=Selector(()))
EVENING = datetime.fromisoformat("2026-03-13T00:00:00Z").timestamp()
STATE = State(
    replace(
        chosen_calibration(
            CAMERA,
            names=("principal_point_x_px", "principal_point_y_px"),
            covariance=0.01 * np.eye(2),
            orders=np.array([[1, 1]]),
        ),
        site=SITE,
    ),
    0, 0, LATE_S, 0.1,
)  # fmt: skip
"""A camera whose clock is an hour ahead."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with three images of a night, one of cloud, and one that is torn."""
    folder, rng = tmp_path_factory.mktemp("night"), np.random.default_rng(1)
    hot = rng.uniform(60.0, SIZE - 60.0, (60, 2)).round() + 0.2
    for name in TIMES:
        cv2.imwrite(str(folder / f"{name}.png"), night_image(rng, name, hot))
    cloud = rng.poisson(900.0, (SIZE, SIZE)).astype(np.uint16)
    cv2.imwrite(str(folder / "20260313_080000.png"), cloud)
    (folder / "20260313_082000.png").write_bytes(b"torn")
    return folder


def camera_in(folder: Path, *names: str) -> CameraImages:
    """Return the camera of a folder, whose times are stated by a clock that is an hour ahead."""
    images = [
        ArchiveImage(microseconds(unix_s(path.stem) + LATE_S), path.name, 0, str(folder), None, "1")
        for path in sorted(folder.glob("*.png"))
        if not names or path.stem in names
    ]  # fmt: skip
    return CameraImages(plan=PLAN, images=(), example=("", ""), family="", size=(SIZE, SIZE), nights=tuple(images))


def microseconds(at: float) -> int:
    return round(1e6 * at)


def unix_s(name: str) -> float:
    return datetime.strptime(f"{name}+0000", "%Y%m%d_%H%M%S%z").timestamp()


def epoch(number: int, first_s: float, last_s: float) -> Epoch:
    return Epoch(number, "start", 0, 0, EVENING + first_s, EVENING + last_s)


ONE = (epoch(0, -DAY_S, 9.0 * DAY_S),)


def looked(nights: CameraNights, folder: Path) -> tuple[NightsLooked, list[Chunk]]:
    """Return what is found in nights, by a ledger in a folder, and what was looked at for it."""
    cluster: Any = InProcess()
    with Ledger(f"sqlite:///{folder / 'ledger.sqlite'}") as ledger:
        (found,) = Passes(ledger, cluster, lambda *_: None).name([nights.work()], run=name_stars)
    return NightsLooked(nights, found), cluster.chunks


@pytest.fixture(scope="module")
def found(folder: Path) -> NightsLooked:
    return looked(collect_nights(camera_in(folder), (STATE,), ONE), folder)[0]


def test_the_stars_of_a_night_are_named_at_the_true_times(found: NightsLooked) -> None:
    kinds = [one.code if isinstance(one, Finding) else "stars" for one in found.looked.found]
    assert kinds == ["stars"] * 3 + ["stars_not_named", "file_not_image"]
    points = star_points(found, (STATE,), ONE)
    assert points is not None
    assert 60 < len(points) <= 90
    assert set(points.unix_s) == {unix_s(name) for name in TIMES}
    apart = np.linalg.norm(points.pixels - project(CAMERA, points.directions), axis=-1)
    assert 0.005 < np.median(apart) < 0.15
    assert np.max(apart) < 1.0
    names = [row[0] for one in found.named() for row in one.stars.rows]
    assert all(name.startswith(STAR) or name in {"jupiter", "venus"} for name in names)
    assert np.allclose(points.directions, body_directions(np.array(names), points.unix_s, SITE))


def test_a_night_is_looked_at_once_and_as_a_whole_when_something_changed(folder: Path, found: NightsLooked) -> None:
    nights = collect_nights(camera_in(folder), (STATE,), ONE)
    again, chunks = looked(nights, folder)
    assert (chunks, again) == ([], found)
    nothing = nights._replace(camera=replace(nights.camera, nights=()), nights=())
    assert looked(nothing, folder)[1] == []
    moved = STATE._replace(calibration=replace(STATE.calibration, camera=replace(CAMERA, rotation_cam_enu=(0, 0, 0))))
    (chunk,) = looked(collect_nights(camera_in(folder), (moved,), ONE), folder)[1]  # another calibration
    assert len(chunk.items) == 5
    (chunk,) = looked(collect_nights(camera_in(folder, *TIMES), (STATE,), ONE), folder)[1]  # other images beside it
    assert len(chunk.items) == 3


def test_no_star_is_sought_where_the_image_shows_no_sky_nor_at_its_edge(folder: Path, tmp_path: Path) -> None:
    hidden = np.zeros((SIZE, SIZE), dtype=bool)
    hidden[:, : SIZE // 3] = True
    nights = collect_nights(camera_in(folder, *TIMES), (STATE,), ONE, [pack_mask(hidden)])
    points = star_points(looked(nights, tmp_path)[0], (STATE,), ONE)
    assert points is not None
    assert len(points) > 30
    assert np.min(points.pixels[:, 0]) > SIZE // 3 + 3.0
    assert nights.nights[0].key != collect_nights(camera_in(folder, *TIMES), (STATE,), ONE).nights[0].key


def test_an_image_that_a_detector_fails_on_leaves_the_others(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = collect_nights(camera_in(folder, *TIMES), (STATE,), ONE).nights[0].images[0].unix_s

    def view(stars: Any, at: float, **options: Any) -> Any:  # noqa: ANN401 - as it is
        if at == first - LATE_S:
            raise ZeroDivisionError
        return star_view(stars, at, **options)

    monkeypatch.setattr(stars_module, "star_view", view)
    one = looked(collect_nights(camera_in(folder, *TIMES), (STATE,), ONE), tmp_path)[0].looked.found
    assert [type(each) for each in one] == [Finding, NamedStars, NamedStars]
    assert isinstance(one[0], Finding)
    assert one[0].code == "image_failed"


def images(nights: int, per_night: int) -> CameraImages:
    begin = EVENING + 5.0 * 3600.0
    found = [
        ArchiveImage(microseconds(begin + night * DAY_S + 60.0 * k), f"{night}-{k:03d}.png", 0, "a", None, "1")
        for night, k in itertools.product(range(nights), range(per_night))
    ]  # fmt: skip
    return CameraImages(plan=PLAN, images=(), example=("", ""), family="", size=(9, 9), nights=tuple(found))


def test_of_a_night_60_images_are_looked_at_spread_over_it() -> None:
    nights = collect_nights(images(2, 119), (STATE,), ONE)
    assert [len(night.images) for night in nights.nights] == [60, 60]
    assert [image.file for image in nights.nights[0].images[:3]] == ["0-000.png", "0-002.png", "0-004.png"]
    assert nights.left_out == ()


@pytest.mark.parametrize(
    ("epochs", "of"),
    [
        ((epoch(0, 0.0, 0.5 * DAY_S), epoch(1, 0.6 * DAY_S, 3 * DAY_S)), [0, 1, 1]),
        ((epoch(0, 0.0, 0.1 * DAY_S), epoch(1, 0.6 * DAY_S, 3 * DAY_S)), [None, 1, 1]),  # it may have moved before
        ((epoch(0, 0.0, 0.1 * DAY_S), epoch(1, 5.001 / 24 * DAY_S, 3 * DAY_S)), [None, 1, 1]),  # within the night
        ((epoch(0, 9 * DAY_S, 10 * DAY_S),), [0, 0, 0]),  # before the first sighting
        ((epoch(0, -9 * DAY_S, -8 * DAY_S),), [0, 0, 0]),  # after the last
        ((), [None, None, None]),
    ],
)
def test_a_night_between_two_poses_is_left_out(epochs: Sequence[Epoch], of: list[int | None]) -> None:
    nights = collect_nights(images(3, 4), (STATE, STATE), epochs)
    known = {night.images[0].file[0]: night.epoch for night in nights.nights}
    assert [known.get(f"{number}") for number in range(3)] == of
    assert {image.file[0] for image in nights.left_out} == {f"{n}" for n, one in enumerate(of) if one is None}


@pytest.fixture(scope="module")
def starry(found: NightsLooked) -> StarFitInput:
    """Return two days of the sun with the stars of the night, and the fit of the sun alone."""
    hours = np.arange(13.5, 25.0, 0.25)
    times = np.concatenate([EVENING + 3600.0 * hours - k * DAY_S for k in (1, 0)])
    directions = sun_directions(times, SITE)
    up = directions[:, 2] > 0.1
    times, directions = times[up], directions[up]
    noise = np.random.default_rng(1).normal(0.0, 0.05, (times.size, 2))
    points = Sightings.of(
        unix_s=times + LATE_S, pixels=project(CAMERA, directions) + noise, sigma_px=np.full(times.size, 0.05)
    )
    camera = ArchiveCamera(SITE, (SIZE, SIZE), CalibrationOptions(projection="equisolid"))
    path = np.zeros(times.size, dtype=np.int64)
    stars = star_points(found, (STATE,), ONE)
    assert stars is not None
    final = Final((STATE,), ONE, path, fit_poses(points, path, (STATE,), camera))
    return StarFitInput(CameraSightings(points, camera, (STATE,)), final, stars)


def test_the_stars_take_part_in_the_calibration(starry: StarFitInput) -> None:
    before, after = starry.final.fitted[0], starry_analysis(starry).fitted[0]
    assert after.calibration.verdict.accepted
    assert after.calibration.night is not None
    assert before.calibration.night is None
    north = np.array([[0.0, np.sin(one), np.cos(one)] for one in np.radians([30.0, 50.0, 70.0])])
    errors = [project(one.calibration.camera, north) - project(CAMERA, north) for one in (before, after)]
    assert np.linalg.norm(errors[1]) < 0.7 * np.linalg.norm(errors[0])
    documents = [
        make_epoch_document(one, starry.given.points, ONE[0], camera="roof", name="001", evidence={})
        for one in (before, after)
    ]
    assert documents[0]["id"] != documents[1]["id"]
    assert documents[1]["evidence"]["selection"]["n_stars"] == len(starry.stars)
    assert "n_stars" not in documents[0]["evidence"]["selection"]


def test_a_refused_fit_of_suns_and_stars_leaves_that_of_the_suns(starry: StarFitInput) -> None:
    good = starry.final.fitted[0]
    verdict = replace(good.calibration.verdict, accepted=False)
    refused = good._replace(calibration=replace(good.calibration, verdict=verdict))
    assert choose_better_calibrations({0: good}, {0: refused}) == {0: good}
    assert choose_better_calibrations({0: refused, 1: good}, {0: good}) == {0: good, 1: good}
    assert choose_better_calibrations({0: refused}, {0: refused._replace(rows=good.rows[:1])})[0].rows.size == 1


def test_stars_of_another_lens_change_nothing(starry: StarFitInput) -> None:
    other = replace(starry.stars, epoch=np.full(len(starry.stars), 7))
    final, given = starry.final, starry.given
    assert fit_poses(given.points, final.path, final.states, given.camera, stars=other) == {}


def test_a_chunk_of_the_night_is_none_of_the_day() -> None:
    with pytest.raises(ValueError, match="day"):
        name_stars(Chunk("roof", "a", "auto", (9, 9), ()))
