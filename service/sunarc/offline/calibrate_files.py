"""A file of sightings in, a calibration document out."""

from __future__ import annotations

import uuid
from pathlib import Path
from typing import Any

import sunarc
from sunarc.archive import read_sightings
from sunarc.calibration import (
    Calibration,
    CalibrationOptions,
    ImageCircle,
    SunPoints,
    calibrate_moved,
    estimate_pose,
    find_image_circle,
    to_document,
)
from sunarc.errors import InputError
from sunarc.extras import extra_module
from sunarc.offline.files import read_image, read_lines, require_inside
from sunarc.offline.project_files import read_calibration
from sunarc.runtime.clock import Clock
from sunarc.sky import Site
from sunarc.utc import utc_time


def calibrate_file(
    path: Path,
    *,
    site: Site,
    image_size: tuple[int, int],
    options: CalibrationOptions,
    clock: Clock,
    circle: ImageCircle | None = None,
    start: Path | None = None,
    pose_only: bool = False,
    plots: Path | None = None,
) -> dict[str, Any]:
    """Fit a file of sightings, draw the result into a folder where one is named, and return the document.

    `pose_only` keeps the lens of the calibration `start` and fits its pose alone.
    """
    if plots is not None:
        extra_module("matplotlib", extra="studies")  # before the fit, which takes minutes
    table = read_sightings(read_lines(path), name=path.name)
    require_inside(table.pixels, image_size, name=path.name)
    points = SunPoints(
        unix_s=table.unix_s,
        pixels=table.pixels,
        sigma_px=table.sigma_px,
        temperature=table.temperature,
        pressure=table.pressure,
    )
    known = None if start is None else read_calibration(start)
    if known is not None and pose_only:
        solved = estimate_pose(points, start=_of_size(known, image_size), site=site, options=options)
    else:
        begin = None if known is None else known.camera
        solved, points = calibrate_moved(
            points, site=site, image_size=image_size, options=options, circle=circle, start=begin
        )
    if plots is not None:
        from sunarc.studies import write_calibration_plots  # noqa: PLC0415 - the plot library is slow to load

        write_calibration_plots(solved, points, folder=plots)
    now = clock.now()
    since = points.unix_s[points.epoch == points.epoch.max()] if len(points) else points.unix_s
    first = utc_time(float(since.min())) if since.size else now
    return to_document(
        solved,
        id=uuid.uuid4().hex,
        camera=path.stem,
        state="candidate" if solved.verdict.accepted else "refused",
        created_at=now,
        valid_from=first,
        valid_until=None,
        pose_epoch="",
        software_version=sunarc.__version__,
    )


def _of_size(known: Calibration, image_size: tuple[int, int]) -> Calibration:
    """Return the calibration whose lens is kept; one of other images would be no answer."""
    size = (known.camera.width, known.camera.height)
    if size != image_size:
        raise InputError(
            field="--start",
            problem=f"is of {size[0]}x{size[1]} images, not {image_size[0]}x{image_size[1]}",
            remedy="name a calibration of this camera",
        )
    return known


def image_circle_of(text: str) -> ImageCircle:
    """Return the image circle that X,Y,RADIUS names, or that a normal daytime image shows (Hough transform)."""
    try:
        x, y, radius = (float(part) for part in text.split(","))
    except ValueError:
        found = find_image_circle(read_image(Path(text)))
        if found is None:
            raise InputError(
                field="--image-circle", problem=f"{text} shows no image circle", remedy="give X,Y,RADIUS in px"
            ) from None
        return found
    return ImageCircle(x=x, y=y, radius=radius)
