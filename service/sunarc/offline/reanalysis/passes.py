"""Both passes over a camera's images: without a prediction, and with that of its states where the sun was not there."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

import sunarc
from sunarc.archive import FileSighting
from sunarc.calibration import SunPoints
from sunarc.detection import Detection, Expectation
from sunarc.findings import Finding
from sunarc.offline.ingest.consensus import expectations, is_consistent
from sunarc.offline.ingest.index import ImageFile
from sunarc.offline.ingest.packed_mask import PackedMask
from sunarc.offline.reanalysis.cluster import Cluster
from sunarc.offline.reanalysis.epochs import Epoch
from sunarc.offline.reanalysis.ledger import ImageId, Ledger
from sunarc.offline.reanalysis.look import Answer, Chunk, Item, key_of
from sunarc.offline.reanalysis.plan import ArchiveImage, CameraImages
from sunarc.offline.reanalysis.states import State
from sunarc.sky import sun_directions
from sunarc.utc import DAY_S

CHUNK = 64
"""Images of a unit of work: some seconds of it, a few kB of answers."""
_MASK_IMAGES = 24
_LEAST_MOTION_DEG = 40.0
"""As in `ingest/series_mask`: the glare of one sun has to leave every place."""
_PIXEL_STEP, _SIGMA_STEP, _STRETCH_STEP, _ZENITH_STEP = 0.25, 0.5, 5.0, 0.01
"""Steps that predictions are rounded to, in px, px, px/rad and rad: a calibration that new images refine must not have
all former ones looked at again."""
SEARCHED, PREDICTED = 1, 2
"""Passes."""

Found = Detection | Finding
ReportProgress = Callable[[str, int, int], None]


class Looked(NamedTuple):
    """A camera's images with what was found in each, in their order."""

    images: tuple[ArchiveImage, ...]
    found: tuple[Found, ...]

    def points(self) -> tuple[SunPoints, list[int]]:
        """Return the accepted sightings at their stated times, and the number of the image of each."""
        accepted = [(row, one) for row, one in enumerate(self.found) if isinstance(one, Detection) and one.accepted]
        points = SunPoints(
            unix_s=np.array([self.images[row].unix_s for row, _ in accepted]),
            pixels=np.array([[one.x_px, one.y_px] for _, one in accepted], dtype=np.float64).reshape(-1, 2),
            sigma_px=np.array([math.nan if one.sigma_px is None else one.sigma_px for _, one in accepted]),
        )
        return points, [row for row, _ in accepted]


class Work(NamedTuple):
    """Images of a camera to look at, and what stands still in them."""

    camera: CameraImages
    items: list[tuple[ArchiveImage, Item]]
    mask: PackedMask | None


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
        work = [
            Work(one, [(image, Item(image.file, image.number, image.exposure_us)) for image in one.images], mask)
            for one, mask in zip(cameras, masks, strict=True)
        ]
        answers = self._looked(work, SEARCHED, "searching")
        return [
            Looked(one.images, tuple(answers[one.plan.name][id_of(image)] for image in one.images)) for one in cameras
        ]

    def predict(
        self,
        searched: Sequence[tuple[CameraImages, Looked, Sequence[Expectation | None]]],
        masks: Sequence[PackedMask | None],
    ) -> list[Looked]:
        """Return what is found where the sun is expected; a sighting that was found there already stays."""
        work = [
            Work(camera, _not_as_expected(looked, expected), mask)
            for (camera, looked, expected), mask in zip(searched, masks, strict=True)
        ]
        answers = self._looked(work, PREDICTED, "with prediction")
        return [
            Looked(
                looked.images,
                tuple(answers[camera.plan.name].get(id_of(i), one) for i, one in zip(*looked, strict=True)),
            )
            for camera, looked, _ in searched
        ]

    def _looked(self, work: Sequence[Work], stage: int, title: str) -> dict[str, dict[ImageId, Found]]:
        """Return the answers for images: those of the ledger that still hold, and new ones, which it is given."""
        total = sum(len(one.items) for one in work)
        answers: dict[str, dict[ImageId, Found]] = {}
        keys: dict[str, dict[ImageId, str]] = {}
        chunks: list[Chunk] = []
        for one in work:
            name = one.camera.plan.name
            keys[name] = {id_of(image): _key(one.camera, image, item, one.mask) for image, item in one.items}
            known = self.ledger.answers(name, stage=stage)
            answers[name] = {i: known[i].found for i, key in keys[name].items() if i in known and known[i].key == key}
            waiting = [(image, item) for image, item in one.items if id_of(image) not in answers[name]]
            chunks += chunks_of(one.camera, waiting, one.mask)
        done = sum(map(len, answers.values()))
        self.progress(title, done, total)

        def keep(chunk: Chunk, found: Iterable[Answer]) -> None:
            nonlocal done
            new = {ImageId(chunk.address, one.file, one.number): one.found for one in found}
            rows = [(i, keys[chunk.camera][i], answer) for i, answer in new.items()]
            self.ledger.store(chunk.camera, stage, rows, version=sunarc.__version__)
            answers[chunk.camera].update(new)
            done += len(new)
            self.progress(title, done, total)

        self.cluster.look(chunks, keep)
        return answers


def _spread(camera: CameraImages) -> Chunk:
    """Return some images spread over all of a camera's first source."""
    address = camera.images[0].address
    of_one = [image for image in camera.images if image.address == address]
    some = sorted(of_one[:: len(of_one) // _MASK_IMAGES + 1], key=lambda image: (image.file, image.number))
    items = tuple(Item(image.file, image.number, None) for image in some)
    return Chunk(camera.plan.name, address, camera.plan.method, camera.size, items)


def _not_as_expected(looked: Looked, expected: Sequence[Expectation | None]) -> list[tuple[ArchiveImage, Item]]:
    return [
        (image, Item(image.file, image.number, image.exposure_us, one, one is None))
        for image, found, one in zip(looked.images, looked.found, expected, strict=True)
        if isinstance(found, Detection) and not is_consistent(_sighting(image, found), one)
    ]


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
        expected += [_rounded(one) for one in expectations(state.calibration, shifted, site=camera.plan.site)]
    return expected


def epoch_at(epochs: Sequence[Epoch], unix_s: float) -> int:
    """Return the number of the epoch of a stated time: that of the last sighting before it."""
    starts = [epoch.start_unix_s for epoch in epochs]
    return max(int(np.searchsorted(starts, unix_s, side="right")) - 1, 0)


def _rounded(one: Expectation | None) -> Expectation | None:
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


def _key(camera: CameraImages, image: ArchiveImage, item: Item, mask: PackedMask | None) -> str:
    """Return the hash of all that an answer rests on."""
    of_mask = None if mask is None else (mask.shape, mask.compressed)
    return key_of((sunarc.__version__, image.stamp, camera.plan.method, camera.size, item, of_mask))


def _sighting(image: ArchiveImage, found: Detection) -> FileSighting:
    return FileSighting(
        time_us=image.time_us,
        exposure_us=image.exposure_us or 0.0,
        file=image.file,
        method=found.method,
        accepted=found.accepted,
        verdict=found.verdict,
        ingest_pass=SEARCHED,
        x_px=found.x_px,
        y_px=found.y_px,
        sigma_px=found.sigma_px,
    )


def _motion_deg(camera: CameraImages) -> float:
    """Return the largest angle between the suns of some images."""
    some = camera.images[:: len(camera.images) // _MASK_IMAGES + 1]
    directions = sun_directions(np.array([image.unix_s for image in some]), camera.plan.site)
    return float(np.degrees(np.arccos(np.clip(directions @ directions.T, -1.0, 1.0)).max()))
