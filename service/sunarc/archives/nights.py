"""Images of the night: which belong to one night, with which calibration their stars are named, and the stars."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from sunarc.archives.passes import Looked, Work, epoch_at
from sunarc.archives.states import Epoch, State
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.array_types import BoolArray, Image
from sunarc.common.findings import Finding, joined
from sunarc.detection.stars.detect import detect_stars
from sunarc.detection.stars.warm_pixels import WarmPixelMap
from sunarc.imager.live.file_frames import make_file_frame
from sunarc.sky.night import body_directions
from sunarc.sources.image_files import images_in
from sunarc.sources.index import ArchiveImage, CameraImages, by_night, evenly
from sunarc.sources.look import Answer, Chunk, Item, NamedStars, PackedMask, StarNaming, result_key
from sunarc.sources.sources import open_source
from sunarc.stars.views import MatchedView, StarView, match_views, star_view, surest_named

_DIGITS = 4
_EDGE_PX = 4
"""Distance from the edge of the horizon within which detections are parts of it."""


class CameraNight(NamedTuple):
    """A night of a camera: the calibration that names its stars, and its images."""

    naming: StarNaming
    images: tuple[ArchiveImage, ...]
    epoch: int

    @property
    def key(self) -> str:
        """Hash of all values that the names rest on: of a night all images are read again, or no image."""
        calibration, camera = self.naming.calibration, self.naming.calibration.camera
        model = (camera, calibration.covariance.tobytes(), self.naming.site, self.naming.clock_offset_s)
        return result_key((model, self.images, self.naming.hidden))


class CameraNights(NamedTuple):
    """The nights of a camera, and its images of nights that no calibration is for."""

    camera: CameraImages
    nights: tuple[CameraNight, ...]
    left_out: tuple[ArchiveImage, ...]

    @property
    def images(self) -> tuple[ArchiveImage, ...]:
        """Images to be read, night by night."""
        return tuple(image for night in self.nights for image in night.images)

    def work(self) -> Work:
        """Return the images as the passes take them: a night of which one image waits is read as a whole."""
        items = [_make_item(one) for one in self.images]
        keys = [key for night in self.nights for key in [night.key] * len(night.images)]
        camera = replace(self.camera, images=self.images)
        return Work(camera, list(enumerate(items)), None, keys=keys, chunks=self._make_chunks)

    def _make_chunks(self, waiting: Collection[int]) -> list[Chunk]:
        """Return a unit of work for each night of which images wait, by their number among the images."""
        plan, begin, chunks = self.camera.plan, 0, list[Chunk]()
        for night in self.nights:
            rows = range(begin, begin + len(night.images))
            begin = rows.stop
            if any(row in waiting for row in rows):
                ordered = sorted(night.images, key=lambda image: (image.file, image.number))
                items = tuple(_make_item(one) for one in ordered)
                chunks.append(
                    Chunk(plan.name, ordered[0].address, plan.method, self.camera.size, items, None, night.naming)
                )
        return chunks


class ImageWithStars(NamedTuple):
    """An image of a night, and the stars that were named in it."""

    night: CameraNight
    image: ArchiveImage
    stars: NamedStars


class NightsLooked(NamedTuple):
    """The nights of a camera, and the stars in their images, in the order of `nights.images`."""

    nights: CameraNights
    looked: Looked

    def named(self) -> Iterator[ImageWithStars]:
        """Yield the images whose stars were named."""
        nights = (night for night in self.nights.nights for _ in night.images)
        for night, image, one in zip(nights, self.looked.images, self.looked.found, strict=True):
            if isinstance(one, NamedStars):
                yield ImageWithStars(night, image, one)


def collect_nights(
    camera: CameraImages, states: Sequence[State], epochs: Sequence[Epoch], hidden: Sequence[PackedMask | None] = ()
) -> CameraNights:
    """Return the nights of a camera, each with the calibration of its epoch, and 60 of its images at most.

    Images between the last sighting of an epoch and the first of the next are left out: which pose they were taken in
    is not known. Without an epoch all are.

    Parameters
    ----------
    camera, states, epochs : the images, and when each state held.
    hidden : the parts of the image that show no sky in each epoch; empty where these are not known.
    """
    nights, left_out = list[CameraNight](), list[ArchiveImage]()
    for _, every in by_night(camera.nights, longitude=camera.plan.site.longitude):
        first, last = every[0].unix_s, every[-1].unix_s
        number = epoch_at(epochs, first) if epochs else 0
        if not epochs or epoch_at(epochs, last) != number or _is_between_epochs(epochs, number, last):
            left_out += every
            continue
        state = states[epochs[number].state]
        mask = hidden[number] if hidden else None
        naming = StarNaming(state.calibration, camera.plan.site, state.clock_offset_s, mask)
        nights += [CameraNight(naming, tuple(evenly(part)), number) for part in _split_by_source(every)]
    return CameraNights(camera, tuple(nights), tuple(left_out))


def _make_item(image: ArchiveImage) -> Item:
    return Item(image.file, image.number, image.exposure_us, unix_s=image.unix_s)


def _is_between_epochs(epochs: Sequence[Epoch], number: int, unix_s: float) -> bool:
    """Return whether a time lies after the last sighting of its epoch and before the first of the next."""
    return number + 1 < len(epochs) and unix_s > epochs[number].end_unix_s


def _split_by_source(images: Sequence[ArchiveImage]) -> list[list[ArchiveImage]]:
    addresses = dict.fromkeys(image.address for image in images)
    return [[image for image in images if image.address == address] for address in addresses]


def name_stars(chunk: Chunk) -> list[Answer]:
    """Return the named stars of each image of a night, or the finding why they are missing."""
    cv2.setNumThreads(1)
    naming = chunk.night
    if naming is None:
        raise ValueError("a chunk of the day")
    found: dict[Item, NamedStars | Finding] = {}
    views: dict[Item, StarView] = {}
    warm, source = WarmPixelMap(), open_source(chunk.address)
    for item in sorted(chunk.items, key=lambda one: one.unix_s):
        for _, image in images_in(source, item.file, [item.number], size=chunk.size):
            if isinstance(image, Finding):
                found[item] = image
                continue
            try:
                views[item] = _make_view(image, item, naming, warm)
            except Exception as error:  # noqa: BLE001 - whatever an image does to a detector, the others go on
                found[item] = Finding("image_failed", {"error": f"{type(error).__name__}: {error}"})
    clean = [replace(view, stars=warm.without_warm(view.stars)) for view in views.values()]
    for item, view, one in zip(views, clean, match_views(clean), strict=True):
        accepted = one.matches.accepted
        found[item] = _make_named_stars(view, one, chunk.size) if accepted else _not_named_finding(one.matches.findings)
    return [Answer(item.file, item.number, found[item]) for item in chunk.items]


def _make_view(image: Image, item: Item, naming: StarNaming, warm: WarmPixelMap) -> StarView:
    """Return the detections of an image, and the stars that are predicted at the time that its clock truly meant."""
    unix_s = item.unix_s - naming.clock_offset_s
    frame = make_file_frame(image, unix_s, item.exposure_us, item.number)
    mask = None if naming.hidden is None else _hidden_pixels(naming.hidden, image)
    stars = detect_stars(warm.repair(frame, None), full_scale=frame.full_scale, mask=mask)
    return star_view(stars, unix_s, site=naming.site, calibration=naming.calibration)


def _hidden_pixels(hidden: PackedMask, image: Image) -> BoolArray:
    """Return the pixels (rows, columns) that show no sky, and those at their edges: bright points of an outline."""
    whole = cv2.resize(hidden.unpacked().astype(np.uint8), image.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    return cv2.dilate(whole, np.ones((2 * _EDGE_PX + 1,) * 2, dtype=np.uint8)).astype(np.bool_)


def _make_named_stars(view: StarView, found: MatchedView, size: tuple[int, int]) -> NamedStars:
    names, stars = surest_named(view, found, size)
    columns = np.column_stack([stars.pixels, stars.sigma_px]).round(_DIGITS).tolist()
    return NamedStars(tuple((str(name), x, y, sigma) for name, (x, y, sigma) in zip(names, columns, strict=True)))


def _not_named_finding(findings: Sequence[Finding]) -> Finding:
    return Finding("stars_not_named", {"error": joined(findings)})


def star_points(found: NightsLooked, states: Sequence[State], epochs: Sequence[Epoch]) -> Sightings | None:
    """Return the named stars of a camera's nights as sightings at their true times, with poses as epochs.

    None without one.
    """
    rows = [
        (one.image.unix_s - one.night.naming.clock_offset_s, states[epochs[one.night.epoch].state].pose, *star)
        for one in found.named()
        for star in one.stars.rows
    ]
    if not rows:
        return None
    unix_s, pose, body, x, y, sigma = (np.array(column) for column in zip(*rows, strict=True))
    return Sightings.of(
        unix_s=unix_s,
        pixels=np.column_stack([x, y]),
        sigma_px=sigma,
        epoch=pose,
        directions=body_directions(body, unix_s, found.nights.camera.plan.site),
        body=body,
    )
