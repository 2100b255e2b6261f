"""First cameras of a fit: a search for each handedness that may be, compared by their plausibility."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal, NamedTuple

from sunarc.calibration.fit.assemble import Job
from sunarc.calibration.start.initial_guess import first_cameras, level_camera
from sunarc.optics.camera import Camera

Hand = Literal["no", "yes"]
"""Handedness of an image, by whether it is mirrored."""


class Start(NamedTuple):
    """First cameras, one for each epoch, and their implausibility in half squares."""

    cameras: list[Camera]
    cost: float

    @property
    def hand(self) -> Hand:
        """Handedness of the cameras: "yes" for mirrored images, "no" for others."""
        return "yes" if self.cameras[0].mirrored else "no"


def most_plausible_start(job: Job) -> Start | None:
    """Return the start for the handedness that is assumed, or for the more plausible of both; None where none is found.

    The job's projection is stated. A handedness that nobody stated is taken for that of an image that is not mirrored.
    """
    stated = job.options.mirrored
    tried: tuple[Hand, ...] = ("no", "yes") if stated == "auto" else (stated or "no",)
    found = [start for hand in tried if (start := plausible_start(job, hand)) is not None]
    return min(found, key=lambda start: start.cost, default=None)


def plausible_start(job: Job, hand: Hand) -> Start | None:
    """Return the most plausible start of one handedness; None where none is found."""
    options = replace(job.options, mirrored=hand)
    guess, known = job.start, True
    if guess is None or guess.mirrored != (hand == "yes"):
        guess = level_camera(job.circle, image_size=job.image_size, options=options)
        known = job.circle is not None
    cameras, cost = first_cameras(job.usable, guess, known=known, options=options, circle=job.circle)
    return Start(cameras, cost) if math.isfinite(cost) else None
