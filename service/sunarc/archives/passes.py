"""Both passes over a camera's images: without a prediction, and with that of its states where the sun was not there."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Final, NamedTuple, Protocol, TypeVar

import numpy as np

from sunarc.archives.ledger import ANY, ImageId, KeptMask, Known
from sunarc.archives.states import Epoch, State
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import robust_sigma
from sunarc.common.utc import DAY_S
from sunarc.detection.values import Detection, Expectation, Verdict
from sunarc.optics.forward import project
from sunarc.sky.directions import angular_distance
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions
from sunarc.sources import expected_sun
from sunarc.sources.index import ArchiveImage, CameraImages, ReportProgress
from sunarc.sources.look import (
    IN_STACK,
    Answer,
    Chunk,
    Done,
    Item,
    NamedStars,
    PackedMask,
    find_static_mask,
    look_at,
    result_key,
    software,
)

CHUNK = 64
"""Images of a unit of work: some seconds of it, a few kB of answers."""
_MASK_IMAGES = 24
_LEAST_MOTION_DEG = 40.0
"""Largest angle between two suns of the images that a mask is made of, at least: the glare of one is 20 degrees wide at
most, and has to leave every place."""
_PIXEL_STEP, _SIGMA_STEP, _STRETCH_STEP, _ZENITH_STEP = 0.25, 0.5, 5.0, 0.01
"""Steps that predictions are rounded to, in px, px, px/rad and rad: a calibration that new images refine must not have
all former ones read again."""
_FEW = 5
FROZEN: Final = "frozen"
"""Verdict of an image whose sun is that of an image before it."""
_SAME_PX, _MOVED_DEG, _MOST_SUNS = 1e-6, 0.25, 60
"""The same image gives the same digits; the sun moves so far in a minute, 1 px of the coarsest lens: by chance it is
seen at no such place again."""


class FoundSun(NamedTuple):
    """Short record of a detection; without a position where it was rejected."""

    accepted: bool
    verdict: Verdict
    x_px: float | None = None
    y_px: float | None = None
    sigma_px: float | None = None


Found = FoundSun | NamedStars | Finding
Given = TypeVar("Given")
Result = TypeVar("Result")


class Looked(NamedTuple):
    """A camera's images with the detection in each, in their order."""

    images: tuple[ArchiveImage, ...]
    found: tuple[Found, ...]

    def points(self) -> tuple[Sightings, list[int]]:
        """Return the accepted sightings at their stated times, and the number of the image of each."""
        accepted = [(row, one) for row, one in enumerate(self.found) if isinstance(one, FoundSun) and one.accepted]
        points = Sightings.of(
            unix_s=np.array([self.images[row].unix_s for row, _ in accepted]),
            pixels=np.array([[one.x_px, one.y_px] for _, one in accepted], dtype=np.float64).reshape(-1, 2),
            sigma_px=np.array([math.nan if one.sigma_px is None else one.sigma_px for _, one in accepted]),
        )
        return points, [row for row, _ in accepted]


class Work(NamedTuple):
    """Images of a camera to read, by their number among its images, and the static parts of them.

    keys: hash of what each of its answers rests on; None where the item states that. chunks: divides images that wait,
    by their numbers, into units of work; None: by source and day.
    """

    camera: CameraImages
    items: Sequence[tuple[int, Item]]
    mask: PackedMask | None
    keys: Sequence[str] | None = None
    chunks: Callable[[Collection[int]], list[Chunk]] | None = None


class AnswerStore(Protocol):
    """Where answers are kept: the ledger of an analysis, or the service's archive; see `Ledger`."""

    def answers(self, camera: str, *, pass_number: int) -> Iterator[tuple[ImageId, Known]]:
        """Yield the answers for a camera's images in a pass."""

    def store(self, camera: str, pass_number: int, answers: Iterable[tuple[ImageId, Known]], *, version: str) -> None:
        """Store the answers of a finished chunk in place of former ones."""

    def mask(self, camera: str, *, version: str) -> KeptMask | None:
        """Return the mask of a camera that was kept; None where none was."""

    def keep_mask(self, camera: str, mask: PackedMask | None, *, version: str) -> None:
        """Keep the mask of a camera."""


class ChunkRunner(Protocol):
    """Runner of chunks: a cluster, or processes of this machine."""

    def each(self, run: Callable[[Given], Result], given: Sequence[Given]) -> list[Result | None]:
        """Return the result of a function for each of some values; None where it could not be done."""

    def look(self, chunks: Sequence[Chunk], done: Done, *, run: Callable[[Chunk], list[Answer]] = look_at) -> None:
        """Process all chunks; `done` is called with each and its answers."""


class Passes(NamedTuple):
    """Both passes over images: without a prediction, then with one."""

    ledger: AnswerStore
    cluster: ChunkRunner
    progress: ReportProgress

    def masks(self, cameras: Sequence[CameraImages]) -> list[PackedMask | None]:
        """Return the static parts of each camera's images; a mask is made once and kept: all answers rest on it."""
        kept = [self.ledger.mask(camera.plan.name, version=software()) for camera in cameras]
        new = [camera for camera, mask in zip(cameras, kept, strict=True) if mask is None]
        moving = [camera for camera in new if _largest_sun_motion_deg(camera) >= _LEAST_MOTION_DEG]
        masks = self.cluster.each(find_static_mask, list(map(_sample_chunk, moving)))
        found = dict(zip((one.plan.name for one in moving), masks, strict=True))
        for camera in new:
            self.ledger.keep_mask(camera.plan.name, found.get(camera.plan.name), version=software())
        return [found.get(one.plan.name) if k is None else k.mask for one, k in zip(cameras, kept, strict=True)]

    def search(self, cameras: Sequence[CameraImages], masks: Sequence[PackedMask | None]) -> list[Looked]:
        """Return the detections in each camera's images without a prediction."""
        work = (
            Work(one, [(n, Item(i.file, i.number, i.exposure_us)) for n, i in enumerate(one.images)], mask)
            for one, mask in zip(cameras, masks, strict=True)
        )
        found = self._process_images(work, expected_sun.SEARCHED, "searching")
        return [_require_all_answers(one.images, new) for one, new in zip(cameras, found, strict=True)]

    def predict(
        self,
        searched: Sequence[tuple[CameraImages, Looked]],
        expected: Iterable[Sequence[Expectation | None]],
        masks: Sequence[PackedMask | None],
    ) -> list[Looked]:
        """Return the detections where the sun is expected; a sighting that was found there already stays.

        `expected` may be made as it is asked for: that of one camera is held at a time.
        """
        work = (
            Work(camera, _select_unexpected(looked, of_camera), mask)
            for (camera, looked), of_camera, mask in zip(searched, expected, masks, strict=True)
        )
        found = self._process_images(work, expected_sun.PREDICTED, "with prediction")
        return [
            _require_all_answers(
                looked.images, (former if one is None else one for one, former in zip(new, looked.found, strict=True))
            )
            for (_, looked), new in zip(searched, found, strict=True)
        ]

    def name(self, work: Iterable[Work], *, run: Callable[[Chunk], list[Answer]]) -> list[Looked]:
        """Return the stars that are named in images of the night; `run` names those of a unit of work."""
        every = list(work)
        found = self._process_images(every, expected_sun.STARS, "naming stars", run=run)
        return [_require_all_answers(one.camera.images, new) for one, new in zip(every, found, strict=True)]

    def _process_images(
        self,
        work: Iterable[Work],
        pass_number: int,
        title: str,
        *,
        run: Callable[[Chunk], list[Answer]] = look_at,
    ) -> list[list[Found | None]]:
        """Return the answer for each of the cameras' images, None where it was not asked for.

        Answers of the ledger that still hold are taken, and it is given the new ones.
        """
        asked: dict[str, _PassAnswers] = {}
        chunks: list[Chunk] = []
        total = 0
        for one in work:
            camera = _PassAnswers(one, self.ledger, pass_number)
            asked[one.camera.plan.name] = camera
            total += len(one.items)
            if one.chunks is not None:
                chunks += one.chunks({n for n, _ in camera.waiting})
            elif one.camera.plan.stacks:
                chunks += _make_stacks(one, dict(camera.waiting))
            else:
                chunks += make_chunks(
                    one.camera, [(one.camera.images[n], item) for n, item in camera.waiting], one.mask
                )
        done = total - sum(len(chunk.items) for chunk in chunks)
        self.progress(title, done, total)

        def store_answers(chunk: Chunk, answers: Sequence[Answer]) -> None:
            nonlocal done
            rows = asked[chunk.camera].answered(chunk, answers)
            self.ledger.store(chunk.camera, pass_number, rows, version=software())
            done += len(rows)
            self.progress(title, done, total)

        self.cluster.look(chunks, store_answers, run=run)
        return [one.found for one in asked.values()]


class _PassAnswers:
    """Answers for a camera's images in one pass.

    Attributes
    ----------
    found : of each of its images; None without one, or where it is not asked for.
    waiting : number and item of the images that the ledger has no answer for that holds. Where all but the stamp of the
        file does, the item has the hash of the content that was read: a file that was only touched keeps its answer.
    """

    def __init__(self, work: Work, ledger: AnswerStore, pass_number: int) -> None:
        self.found: list[Found | None] = [None] * len(work.camera.images)
        self._camera, self._keys = work.camera, work.keys
        self._of_mask = None if work.mask is None else result_key((work.mask.shape, work.mask.compressed))
        self._row = {make_image_id(work.camera.images[n]): n for n, _ in work.items}
        self._touched: dict[int, Known] = {}
        items = dict(work.items)
        for image, known in ledger.answers(work.camera.plan.name, pass_number=pass_number):
            row = self._row.get(image)
            if row is None or known.key not in {ANY, self._hash_inputs(row, items[row])}:
                continue
            if known.stamp in {ANY, self._hash_stamp(row)}:
                self.found[row] = kept(known.found)
            elif known.content is not None:
                self._touched[row] = known
        self.waiting = [(n, self._attach_content(n, item)) for n, item in work.items if self.found[n] is None]

    def _attach_content(self, row: int, item: Item) -> Item:
        return item._replace(content=self._touched[row].content) if row in self._touched else item

    def answered(self, chunk: Chunk, answers: Sequence[Answer]) -> list[tuple[ImageId, Known]]:
        """Take the answers for a chunk; return them as the ledger stores them."""
        items = {(item.file, item.number): item for item in chunk.items}
        rows = []
        for one in answers:
            image = ImageId(chunk.address, one.file, one.number)
            row = self._row[image]
            found = self._touched[row].found if one.found is None else one.found
            self.found[row] = kept(found)
            rows.append(
                (
                    image,
                    Known(
                        self._hash_inputs(row, items[one.file, one.number]), found, self._hash_stamp(row), one.content
                    ),
                )
            )
        return rows

    def _hash_stamp(self, row: int) -> str:
        return result_key((self._camera.images[row].stamp,))

    def _hash_inputs(self, row: int, item: Item) -> str:
        """Return the hash of all values that an answer rests on apart from the file."""
        if self._keys is not None:
            return result_key((software(), self._keys[row]))
        plan, size = self._camera.plan, self._camera.size
        return result_key((software(), plan.method, size, item._replace(content=None), self._of_mask))


def kept(found: Detection | NamedStars | Finding) -> Found:
    """Return the short record of an answer."""
    if isinstance(found, Finding | NamedStars):
        return found
    if not found.accepted:
        return _make_rejected_sun(found.verdict)
    return FoundSun(accepted=True, verdict=found.verdict, x_px=found.x_px, y_px=found.y_px, sigma_px=found.sigma_px)


@cache  # one value for all of them: most images of a cloudy year are alike
def _make_rejected_sun(verdict: Verdict) -> FoundSun:
    return FoundSun(accepted=False, verdict=verdict)


def _require_all_answers(images: tuple[ArchiveImage, ...], found: Iterable[Found | None]) -> Looked:
    """Return images with their answers, all of which are there."""
    return Looked(images, tuple(one for one in found if one is not None))


def _sample_chunk(camera: CameraImages) -> Chunk:
    """Return images spread over all of a camera's first source, as a chunk."""
    address = camera.images[0].address
    of_one = [image for image in camera.images if image.address == address]
    some = sorted(of_one[:: len(of_one) // _MASK_IMAGES + 1], key=lambda image: (image.file, image.number))
    items = tuple(Item(image.file, image.number, None) for image in some)
    return Chunk(camera.plan.name, address, camera.plan.method, camera.size, items)


def _select_unexpected(looked: Looked, expected: Sequence[Expectation | None]) -> list[tuple[int, Item]]:
    """Return the images whose sighting is not where the sun should be; of a stack all, where its sighting is not."""
    suns = [
        (number, image, found, one)
        for number, (image, found, one) in enumerate(zip(looked.images, looked.found, expected, strict=True))
        if isinstance(found, FoundSun)
    ]
    again = [
        one
        for one in suns
        if one[2].verdict not in {IN_STACK, FROZEN} and not expected_sun.is_consistent(one[2], one[3])
    ]
    stacked = {image.time_us for _, image, found, _ in suns if found.verdict == IN_STACK}
    times = {image.time_us for _, image, _, _ in again} & stacked
    numbers = {number for number, *_ in again}
    return [
        (number, Item(image.file, image.number, image.exposure_us, one, one is None, _get_place(found)))
        for number, image, found, one in suns
        if number in numbers or image.time_us in times
    ]


def by_true_times(camera: CameraImages, states: Sequence[State], epochs: Sequence[Epoch]) -> CameraImages:
    """Return a camera with the images of its dusk and nights that are of the day by the clock of their epoch."""
    others = (*camera.dusk, *camera.nights)
    if not epochs or not others:
        return camera
    ahead_s = np.array([states[epochs[epoch_at(epochs, one.unix_s)].state].clock_offset_s for one in others])
    if not np.any(ahead_s):
        return camera
    zenith = np.asarray(
        sun_angles(np.array([one.unix_s for one in others]) - ahead_s, camera.plan.site).apparent_zenith
    )
    is_light = (zenith <= camera.plan.largest_zenith_deg) & (ahead_s != 0.0)
    light = {make_image_id(others[row]) for row in np.flatnonzero(is_light)}
    by_day = sorted((*camera.images, *(one for one in others if make_image_id(one) in light)))
    dusk, nights = (
        tuple(one for one in some if make_image_id(one) not in light) for some in (camera.dusk, camera.nights)
    )
    return replace(camera, images=tuple(by_day), dusk=dusk, nights=nights)


def without_frozen(looked: Looked, site: Site) -> Looked:
    """Return the detections, each sun at the place of an earlier one rejected as frozen: the sun had moved.

    Parameters
    ----------
    looked : images in the order of time.
    site : where the camera stands.
    """
    found, seen = list(looked.found), deque[tuple[float, float, float]](maxlen=_MOST_SUNS)
    for row, (image, one) in enumerate(zip(looked.images, looked.found, strict=True)):
        if not isinstance(one, FoundSun) or not one.accepted or one.x_px is None or one.y_px is None:
            continue
        same = [at for at, x, y in seen if max(abs(x - one.x_px), abs(y - one.y_px)) < _SAME_PX]
        if any(_sun_motion_deg(at, image.unix_s, site) > _MOVED_DEG for at in same):
            found[row] = _make_rejected_sun(FROZEN)
        else:
            seen.append((image.unix_s, one.x_px, one.y_px))
    return Looked(looked.images, tuple(found))


def _sun_motion_deg(earlier_s: float, later_s: float, site: Site) -> float:
    """Return the angle between the suns of two times."""
    return math.degrees(float(angular_distance(*sun_directions(np.array([earlier_s, later_s]), site))))


def without_lifted(searched: Looked, looked: Looked, refused: Sequence[bool]) -> Looked:
    """Return the second pass with the first one's rejections, where a refused epoch's prediction lifted them.

    Parameters
    ----------
    searched, looked : both passes over the same images.
    refused : of each image, whether the calibration of its epoch is refused: its prediction proves nothing.
    """
    pairs = zip(searched.found, looked.found, refused, strict=True)
    found = (
        first if is_refused and _is_newly_accepted(first, second) else second for first, second, is_refused in pairs
    )
    return Looked(looked.images, tuple(found))


def _is_newly_accepted(first: Found, second: Found) -> bool:
    if not isinstance(first, FoundSun) or not isinstance(second, FoundSun):
        return False
    return second.accepted and not first.accepted


def _get_place(found: FoundSun) -> tuple[float, float] | None:
    return None if found.x_px is None or found.y_px is None else (found.x_px, found.y_px)


def make_image_id(image: ArchiveImage) -> ImageId:
    """Return which image it is in the ledger."""
    return ImageId(image.address, image.file, image.number)


def make_chunks(
    camera: CameraImages, items: Iterable[tuple[ArchiveImage, Item]], mask: PackedMask | None
) -> list[Chunk]:
    """Return images as units of work: of one source and day each, in the order of their files."""
    ordered = sorted(items, key=lambda one: (*_source_and_day(one[0]), one[0].file, one[0].number))
    chunks = []
    for (address, _), members in itertools.groupby(ordered, key=lambda one: _source_and_day(one[0])):
        of_day = [item for _, item in members]
        for begin in range(0, len(of_day), CHUNK):
            part = tuple(of_day[begin : begin + CHUNK])
            chunks.append(Chunk(camera.plan.name, address, camera.plan.method, camera.size, part, mask))
    return chunks


def _make_stacks(work: Work, waiting: Mapping[int, Item]) -> list[Chunk]:
    """Return a unit of work for each time at which an image waits, with all images of that time.

    Images that are alone at their time are together, unless they are to be read one by one.
    """
    plan, size = work.camera.plan, work.camera.size
    by_time: dict[int, list[tuple[int, Item]]] = {}
    for number, item in work.items:
        by_time.setdefault(work.camera.images[number].time_us, []).append((number, item))
    stacks = [
        part
        for members in by_time.values()
        for part in ([members] if len(members) <= expected_sun.MOST_EXPOSURES else [[one] for one in members])
        if any(number in waiting for number, _ in part)
    ]
    alone = [] if plan.one_by_one else [part[0] for part in stacks if len(part) == 1]
    together = [
        Chunk(
            plan.name,
            work.camera.images[part[0][0]].address,
            plan.method,
            size,
            tuple(item for _, item in part),
            work.mask,
            stack=len(part) > 1,
        )
        for part in stacks
        if len(part) > 1 or plan.one_by_one
    ]
    return make_chunks(work.camera, [(work.camera.images[n], waiting[n]) for n, _ in alone], work.mask) + together


def _source_and_day(image: ArchiveImage) -> tuple[str, int]:
    return image.address, int(image.unix_s // DAY_S)


def predictions(
    camera: CameraImages, states: Sequence[State], epochs: Sequence[Epoch], *, misfit_px: Sequence[float] | None = None
) -> list[Expectation | None]:
    """Return where the sun should be in each image, rounded; None where it is outside the image.

    Parameters
    ----------
    camera, states, epochs : the images, and when each state held.
    misfit_px : by how much each state is wrong beyond its covariance; None for the scatter of what it was fitted to.
    """
    expected: list[Expectation | None] = []
    for number, members in itertools.groupby(camera.images, key=lambda image: epoch_at(epochs, image.unix_s)):
        state = states[epochs[number].state]
        times = np.array([image.unix_s for image in members]) - state.clock_offset_s
        misfit = None if misfit_px is None else misfit_px[epochs[number].state]
        found = expected_sun.expectations(state.calibration, times, site=camera.plan.site, misfit_px=misfit)
        expected += [rounded(one) for one in found]
    return expected


def scatter_beyond_px(calibration: Calibration, points: Sightings, *, site: Site) -> float:
    """Return the scatter of accepted sightings about a camera beyond their sigma, px per axis.

    That of the fit where they are too few to determine it.
    """
    stated = points.select(np.flatnonzero(np.isfinite(points.sigma_px)))
    if len(stated) < _FEW:
        return float(np.nan_to_num(calibration.evidence.sigma_px))
    off = stated.pixels - project(calibration.camera, sun_directions(stated.unix_s, site))
    ratio = np.linalg.norm(off, axis=-1) / stated.sigma_px
    factor = robust_sigma(ratio[np.isfinite(ratio)], floor=1.0)
    return math.sqrt(factor**2 - 1.0) * float(np.median(stated.sigma_px))


def epoch_at(epochs: Sequence[Epoch], unix_s: float) -> int:
    """Return the number of the epoch of a stated time: that of the last sighting before it."""
    starts = [epoch.start_unix_s for epoch in epochs]
    return max(int(np.searchsorted(starts, unix_s, side="right")) - 1, 0)


def rounded(one: Expectation | None) -> Expectation | None:
    """Return a prediction rounded to a quarter of a pixel, its sigma to half a pixel."""
    if one is None:
        return None
    stretch = one.stretch_px_per_rad
    (a, b), (c, d) = stretch if stretch is not None else ((0.0, 0.0), (0.0, 0.0))
    return Expectation(
        x_px=_round_to_step(one.x_px, _PIXEL_STEP),
        y_px=_round_to_step(one.y_px, _PIXEL_STEP),
        uncertainty_px=max(_round_to_step(one.uncertainty_px, _SIGMA_STEP), _SIGMA_STEP),
        stretch_px_per_rad=None
        if stretch is None
        else ((_round_to_step(a), _round_to_step(b)), (_round_to_step(c), _round_to_step(d))),
        apparent_zenith=None if one.apparent_zenith is None else _round_to_step(one.apparent_zenith, _ZENITH_STEP),
    )


def _round_to_step(value: float, step: float = _STRETCH_STEP) -> float:
    return step * round(value / step)


def _largest_sun_motion_deg(camera: CameraImages) -> float:
    """Return the largest angle between the suns of some images."""
    some = camera.images[:: len(camera.images) // _MASK_IMAGES + 1]
    if not some:
        return 0.0
    directions = sun_directions(np.array([image.unix_s for image in some]), camera.plan.site)
    return float(np.degrees(np.arccos(np.clip(directions @ directions.T, -1.0, 1.0)).max()))
