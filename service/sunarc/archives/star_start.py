"""States of a camera by the stars of its nights: where no sun was found, or where a given camera is to be confirmed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from sunarc.archives.fit import Rough, doubts
from sunarc.archives.states import ArchiveCamera, Epoch, State, classify_cause
from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import evenly_spread
from sunarc.common.findings import Finding
from sunarc.common.utc import utc_time
from sunarc.public.star_files import StarImage, StarOptions, blind_result, detect_star_image, named_stars
from sunarc.sources.image_files import images_in
from sunarc.sources.index import ArchiveImage, all_at_night, by_night
from sunarc.sources.sources import open_source
from sunarc.stars.blind_start import BlindOptions

_IMAGES = 6
"""Images of a night that a camera is sought in: evenly over it."""
_MOST_NIGHTS = 60
"""Nights, evenly over the archive, by which it is decided when a state held."""
_MOST_STARTS = 12
"""Nights in which a camera is sought without a start; each takes seconds, and nights of cloud give none."""
_MOST_TILT_DEG = 45.0
_SAME_LENS = 0.02
"""Difference of focal lengths up to which two states have one lens: a start by stars states them to .2 %."""


class CameraNightImages(NamedTuple):
    """Images of a camera's nights in order of time, and its known states."""

    images: tuple[ArchiveImage, ...]
    camera: ArchiveCamera
    states: tuple[State, ...] = ()


class _Night(NamedTuple):
    first_unix_s: float
    last_unix_s: float
    images: list[ArchiveImage]


def first_by_stars(given: CameraNightImages) -> Rough:
    """Return the states and epochs that the stars of a camera's nights show, or the findings why they are missing.

    A night belongs to the first state by which the stars of one of its images are named; without such a state, the
    camera is sought in it without a start. Nights without stars belong to no state.
    """
    cv2.setNumThreads(1)
    found = _StarSearch(given)
    held = [(night, number) for night in found.nights if (number := found.named_state(night)) is not None]
    if not held:
        at_night = all_at_night(given.images, given.camera.site)
        return Rough(findings=(*found.refused[:1], at_night))
    numbers = list(dict.fromkeys(number for _, number in held))
    states = [found.states[number] for number in numbers]
    epochs = _make_epochs([(night, numbers.index(number)) for night, number in held], states)
    options = given.camera.options  # a hand that is not stated is the one that the stars show
    asked = given.camera._replace(options=replace(options, mirrored=options.mirrored or "auto"))
    return Rough(tuple(states), tuple(epochs), doubts(states[0].calibration, asked))


class _StarSearch:
    """The search for the state of each night.

    Attributes
    ----------
    nights : those by which the states are decided, in the order of time.
    states : known and found.
    refused : of nights without a state, why the camera was not found in them.
    """

    def __init__(self, given: CameraNightImages) -> None:
        every = [
            _Night(images[0].unix_s, images[-1].unix_s, images)
            for _, images in by_night(given.images, longitude=given.camera.site.longitude)
        ]
        self.nights = [every[row] for row in evenly_spread(len(every), most=_MOST_NIGHTS).tolist()]
        self.states = list(given.states)
        self.refused: list[Finding] = []
        self._camera, self._starts = given.camera, 0
        self._read: dict[float, list[StarImage]] = {}
        if not self.states:  # the first camera is sought where most images are
            for night in sorted(self.nights, key=lambda one: -len(one.images)):
                if self._start_blind(self._read_stars(night)) is not None:
                    break

    def named_state(self, night: _Night) -> int | None:
        """Return the number of the state that a night's stars are named by; None without one."""
        seen = self._read_stars(night)
        for number, state in enumerate(self.states):
            named = named_stars(seen, state.calibration)
            if any(one.matches is not None and one.matches.accepted for one in named):
                return number
        return self._start_blind(seen)

    def _start_blind(self, seen: list[StarImage]) -> int | None:
        """Return the number of a new state that a night's stars show without a start."""
        if self._starts >= _MOST_STARTS or not seen:
            return None
        self._starts += 1
        limit = self._camera.options.level_within_deg
        known = BlindOptions(level_within_deg=None if limit is None else min(limit, _MOST_TILT_DEG))
        found = blind_result(seen, self._camera.site, StarOptions(), known=known)
        if not found.accepted or found.calibration is None:
            self.refused += found.findings[:1]
            return None
        self.states.append(_new_state(found.calibration, self.states))
        return len(self.states) - 1

    def _read_stars(self, night: _Night) -> list[StarImage]:
        if night.first_unix_s not in self._read:
            some = [night.images[row] for row in evenly_spread(len(night.images), most=_IMAGES).tolist()]
            self._read[night.first_unix_s] = [one for image in some for one in self._detect_stars(image)]
        return self._read[night.first_unix_s]

    def _detect_stars(self, image: ArchiveImage) -> list[StarImage]:
        """Return the detections of an image; nothing where it cannot be read."""
        camera = self._camera
        source = open_source(image.address)
        return [
            detect_star_image(pixels, utc_time(image.unix_s), camera.site, StarOptions(), name=image.name)
            for _, pixels in images_in(source, image.file, [image.number], size=camera.size)
            if not isinstance(pixels, Finding)
        ]


def _new_state(calibration: Calibration, states: Sequence[State]) -> State:
    """Return a state of a new pose, with the lens of a known state where the focal lengths agree."""
    focal = calibration.camera.focal_length_px[0]
    apart = [abs(one.calibration.camera.focal_length_px[0] / focal - 1.0) for one in states]
    alike = [one.lens for one, share in zip(states, apart, strict=True) if share < _SAME_LENS]
    lens = alike[0] if alike else 1 + max((one.lens for one in states), default=-1)
    pose = 1 + max((one.pose for one in states), default=-1)
    return State(calibration, lens, pose, 0.0, float(np.nan_to_num(calibration.evidence.sigma_px)))


def _make_epochs(held: Sequence[tuple[_Night, int]], states: Sequence[State]) -> list[Epoch]:
    """Return the epochs of nights in the order of time, each of a state."""
    epochs: list[Epoch] = []
    for night, number in held:
        if epochs and epochs[-1].state == number:
            epochs[-1] = epochs[-1]._replace(end_unix_s=night.last_unix_s)
        else:
            cause = classify_cause(states[epochs[-1].state], states[number]) if epochs else "start"
            epochs.append(Epoch(number, cause, 0, -1, night.first_unix_s, night.last_unix_s))
    return epochs
