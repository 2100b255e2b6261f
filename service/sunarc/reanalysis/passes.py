"""Both passes over a camera's images: without a prediction, and with that of its states where the sun was not there."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterable, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

import sunarc
from sunarc.calibration.model.sightings import Sightings
from sunarc.detection.values import Detection, Expectation, Verdict
from sunarc.findings import Finding
from sunarc.reanalysis.cluster import Cluster
from sunarc.reanalysis.consensus import expectations, is_consistent
from sunarc.reanalysis.index import ArchiveImage, CameraImages, ImageFile
from sunarc.reanalysis.ledger import ImageId, Known, Ledger
from sunarc.reanalysis.look import Answer, Chunk, Item, NamedStars, PackedMask, key_of, look_at
from sunarc.reanalysis.states import Epoch, State
from sunarc.sky.sun import sun_directions
from sunarc.utc import DAY_S

CHUNK = 64
"""Images of a unit of work: some seconds of it, a few kB of answers."""
_MASK_IMAGES = 24
_LEAST_MOTION_DEG = 40.0
"""As in `ingest/series_mask`: the glare of one sun has to leave every place."""
_PIXEL_STEP, _SIGMA_STEP, _STRETCH_STEP, _ZENITH_STEP = 0.25, 0.5, 5.0, 0.01
"""Steps that predictions are rounded to, in px, px, px/rad and rad: a calibration that new images refine must not have
all former ones looked at again."""
SEARCHED, PREDICTED, STARS = 1, 2, 3
"""Passes; the third is over the images of the night."""


class FoundSun(NamedTuple):
    """What a run keeps of a detection: all of it stands in the ledger. Without a position where it was rejected."""

    accepted: bool
    verdict: Verdict
    x_px: float | None = None
    y_px: float | None = None
    sigma_px: float | None = None


Found = FoundSun | NamedStars | Finding
ReportProgress = Callable[[str, int, int], None]


class Looked(NamedTuple):
    """A camera's images with what was found in each, in their order."""

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
    """Images of a camera to look at, by their number among its images, and what stands still in them.

    keys: hash of what each of its answers rests on; None where the item tells that. chunks: divides images that wait,
    by their numbers, into units of work; None: by source and day.
    """

    camera: CameraImages
    items: Sequence[tuple[int, Item]]
    mask: PackedMask | None
    keys: Sequence[str] | None = None
    chunks: Callable[[Collection[int]], list[Chunk]] | None = None


class Passes(NamedTuple):
    """What both passes need of a run."""

    ledger: Ledger
    cluster: Cluster
    progress: ReportProgress

    def masks(self, cameras: Sequence[CameraImages]) -> list[PackedMask | None]:
        """Return what stands still in each camera's images; what was seen once is kept: all answers rest on it."""
        kept = [self.ledger.mask(camera.plan.name, version=sunarc.__version__) for camera in cameras]
        new = [camera for camera, mask in zip(cameras, kept, strict=True) if mask is None]
        moving = [camera for camera in new if _motion_deg(camera) >= _LEAST_MOTION_DEG]
        found = dict(
            zip((one.plan.name for one in moving), self.cluster.masks(list(map(_spread, moving))), strict=True)
        )
        for camera in new:
            self.ledger.keep_mask(camera.plan.name, found.get(camera.plan.name), version=sunarc.__version__)
        return [found.get(one.plan.name) if k is None else k.mask for one, k in zip(cameras, kept, strict=True)]

    def search(self, cameras: Sequence[CameraImages], masks: Sequence[PackedMask | None]) -> list[Looked]:
        """Return what is found in each camera's images without a prediction."""
        work = (
            Work(one, [(n, Item(i.file, i.number, i.exposure_us)) for n, i in enumerate(one.images)], mask)
            for one, mask in zip(cameras, masks, strict=True)
        )
        found = self._looked(work, SEARCHED, "searching")
        return [_complete(one.images, new) for one, new in zip(cameras, found, strict=True)]

    def predict(
        self,
        searched: Sequence[tuple[CameraImages, Looked]],
        expected: Iterable[Sequence[Expectation | None]],
        masks: Sequence[PackedMask | None],
    ) -> list[Looked]:
        """Return what is found where the sun is expected; a sighting that was found there already stays.

        `expected` may be made as it is asked for: that of one camera is held at a time.
        """
        work = (
            Work(camera, _not_as_expected(looked, of_camera), mask)
            for (camera, looked), of_camera, mask in zip(searched, expected, masks, strict=True)
        )
        found = self._looked(work, PREDICTED, "with prediction")
        return [
            _complete(
                looked.images, (former if one is None else one for one, former in zip(new, looked.found, strict=True))
            )
            for (_, looked), new in zip(searched, found, strict=True)
        ]

    def name(self, work: Iterable[Work], *, run: Callable[[Chunk], list[Answer]]) -> list[Looked]:
        """Return the stars that are named in images of the night; `run` names those of a unit of work."""
        every = list(work)
        found = self._looked(every, STARS, "naming stars", run=run)
        return [_complete(one.camera.images, new) for one, new in zip(every, found, strict=True)]

    def _looked(
        self,
        work: Iterable[Work],
        stage: int,
        title: str,
        *,
        run: Callable[[Chunk], list[Answer]] = look_at,
    ) -> list[list[Found | None]]:
        """Return the answer for each of the cameras' images, None where it was not asked for.

        Answers of the ledger that still hold are taken, and it is given the new ones.
        """
        asked: dict[str, _Question] = {}
        chunks: list[Chunk] = []
        total = 0
        for one in work:
            camera = _Question(one, self.ledger, stage)
            asked[one.camera.plan.name] = camera
            total += len(one.items)
            if one.chunks is not None:
                chunks += one.chunks({n for n, _ in camera.waiting})
                continue
            chunks += chunks_of(one.camera, [(one.camera.images[n], item) for n, item in camera.waiting], one.mask)
        done = total - sum(len(chunk.items) for chunk in chunks)
        self.progress(title, done, total)

        def keep(chunk: Chunk, answers: Sequence[Answer]) -> None:
            nonlocal done
            rows = asked[chunk.camera].answered(chunk, answers)
            self.ledger.store(chunk.camera, stage, rows, version=sunarc.__version__)
            done += len(rows)
            self.progress(title, done, total)

        self.cluster.look(chunks, keep, run=run)
        return [one.found for one in asked.values()]


class _Question:
    """A camera's answers in a pass, as they come.

    Attributes
    ----------
    found : of each of its images; None where there is none yet, or it is not asked for.
    waiting : number and item of the images that the ledger has no answer for that holds. Where all but the stamp of the
        file does, the item has the hash of the content that was read: a file that was only touched keeps its answer.
    """

    def __init__(self, work: Work, ledger: Ledger, stage: int) -> None:
        self.found: list[Found | None] = [None] * len(work.camera.images)
        self._camera, self._keys = work.camera, work.keys
        self._of_mask = None if work.mask is None else key_of((work.mask.shape, work.mask.compressed))
        self._row = {id_of(work.camera.images[n]): n for n, _ in work.items}
        self._touched: dict[int, Known] = {}
        items = dict(work.items)
        for image, known in ledger.answers(work.camera.plan.name, stage=stage):
            row = self._row.get(image)
            if row is None or known.key != self._key(row, items[row]):
                continue
            if known.stamp == self._stamp(row):
                self.found[row] = kept(known.found)
            elif known.content is not None:
                self._touched[row] = known
        self.waiting = [(n, self._with_content(n, item)) for n, item in work.items if self.found[n] is None]

    def _with_content(self, row: int, item: Item) -> Item:
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
                (image, Known(self._key(row, items[one.file, one.number]), found, self._stamp(row), one.content))
            )
        return rows

    def _stamp(self, row: int) -> str:
        return key_of((self._camera.images[row].stamp,))

    def _key(self, row: int, item: Item) -> str:
        """Return the hash of all that an answer rests on beside the file."""
        if self._keys is not None:
            return key_of((sunarc.__version__, self._keys[row]))
        plan, size = self._camera.plan, self._camera.size
        return key_of((sunarc.__version__, plan.method, size, item._replace(content=None), self._of_mask))


def kept(found: Detection | NamedStars | Finding) -> Found:
    """Return what a run keeps of an answer."""
    if isinstance(found, Finding | NamedStars):
        return found
    if not found.accepted:
        return _rejected(found.verdict)
    return FoundSun(accepted=True, verdict=found.verdict, x_px=found.x_px, y_px=found.y_px, sigma_px=found.sigma_px)


@cache  # one value for all of them: most images of a cloudy year are alike
def _rejected(verdict: Verdict) -> FoundSun:
    return FoundSun(accepted=False, verdict=verdict)


def _complete(images: tuple[ArchiveImage, ...], found: Iterable[Found | None]) -> Looked:
    """Return images with their answers, all of which are there."""
    return Looked(images, tuple(one for one in found if one is not None))


def _spread(camera: CameraImages) -> Chunk:
    """Return some images spread over all of a camera's first source."""
    address = camera.images[0].address
    of_one = [image for image in camera.images if image.address == address]
    some = sorted(of_one[:: len(of_one) // _MASK_IMAGES + 1], key=lambda image: (image.file, image.number))
    items = tuple(Item(image.file, image.number, None) for image in some)
    return Chunk(camera.plan.name, address, camera.plan.method, camera.size, items)


def _not_as_expected(looked: Looked, expected: Sequence[Expectation | None]) -> list[tuple[int, Item]]:
    return [
        (number, Item(image.file, image.number, image.exposure_us, one, one is None, _place(found)))
        for number, (image, found, one) in enumerate(zip(looked.images, looked.found, expected, strict=True))
        if isinstance(found, FoundSun) and not is_consistent(found, one)
    ]


def _place(found: FoundSun) -> tuple[float, float] | None:
    return None if found.x_px is None or found.y_px is None else (found.x_px, found.y_px)


def id_of(image: ArchiveImage) -> ImageId:
    """Return which image it is in the ledger."""
    return ImageId(image.address, image.file, image.number)


def chunks_of(camera: CameraImages, items: Iterable[tuple[ArchiveImage, Item]], mask: PackedMask | None) -> list[Chunk]:
    """Return images as units of work: of one source and day each, in the order of their files."""
    ordered = sorted(items, key=lambda one: (*_source_and_day(one[0]), one[0].file, one[0].number))
    chunks = []
    for (address, _), members in itertools.groupby(ordered, key=lambda one: _source_and_day(one[0])):
        of_day = [item for _, item in members]
        for begin in range(0, len(of_day), CHUNK):
            part = tuple(of_day[begin : begin + CHUNK])
            chunks.append(Chunk(camera.plan.name, address, camera.plan.method, camera.size, part, mask))
    return chunks


def _source_and_day(image: ArchiveImage) -> tuple[str, int]:
    return image.address, int(image.unix_s // DAY_S)


def predictions(camera: CameraImages, states: Sequence[State], epochs: Sequence[Epoch]) -> list[Expectation | None]:
    """Return where the sun should be in each image, rounded; None where it is outside the image."""
    expected: list[Expectation | None] = []
    for number, members in itertools.groupby(camera.images, key=lambda image: epoch_at(epochs, image.unix_s)):
        state = states[epochs[number].state]
        shifted = [
            ImageFile(image.file, (round(1e6 * (image.unix_s - state.clock_offset_s)), 0.0, image.file))
            for image in members
        ]
        expected += [rounded(one) for one in expectations(state.calibration, shifted, site=camera.plan.site)]
    return expected


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
        x_px=_step(one.x_px, _PIXEL_STEP),
        y_px=_step(one.y_px, _PIXEL_STEP),
        uncertainty_px=max(_step(one.uncertainty_px, _SIGMA_STEP), _SIGMA_STEP),
        stretch_px_per_rad=None if stretch is None else ((_step(a), _step(b)), (_step(c), _step(d))),
        apparent_zenith=None if one.apparent_zenith is None else _step(one.apparent_zenith, _ZENITH_STEP),
    )


def _step(value: float, step: float = _STRETCH_STEP) -> float:
    return step * round(value / step)


def _motion_deg(camera: CameraImages) -> float:
    """Return the largest angle between the suns of some images."""
    some = camera.images[:: len(camera.images) // _MASK_IMAGES + 1]
    directions = sun_directions(np.array([image.unix_s for image in some]), camera.plan.site)
    return float(np.degrees(np.arccos(np.clip(directions @ directions.T, -1.0, 1.0)).max()))
