"""A file of sightings in, a calibration document out."""

from __future__ import annotations

import math
import uuid
from dataclasses import replace
from pathlib import Path
from typing import Any

import sunarc
from sunarc.archive.csv_files import read_sightings
from sunarc.calibration.initial_guess.image_circle import find_image_circle
from sunarc.calibration.lens_library.first_pose import calibrate_with_lens
from sunarc.calibration.lens_library.lens_type import LensType
from sunarc.calibration.model.document import to_document
from sunarc.calibration.model.kinds import kinds_of
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.sightings import SunPoints
from sunarc.calibration.pose.estimate_pose import estimate_pose
from sunarc.calibration.pose.stated_prior import PriorTolerances, calibrate_with_prior
from sunarc.calibration.pose_change_points import calibrate_moved
from sunarc.calibration.projection_choice import calibrate_unknown_lens
from sunarc.errors import InputError
from sunarc.exports.start import closest_camera
from sunarc.extras import extra_module
from sunarc.offline.compare_files import read_view_file
from sunarc.offline.files import read_image, read_lines, require_inside
from sunarc.offline.lens_priors import require_lens
from sunarc.offline.project_files import read_calibration
from sunarc.optics.camera import Camera
from sunarc.runtime.clock import Clock
from sunarc.sky.site import Site
from sunarc.utc import utc_time


def calibrate_file(
    path: Path,
    *,
    site: Site,
    image_size: tuple[int, int],
    options: CalibrationOptions,
    clock: Clock,
    projection_known: bool = True,
    circle: ImageCircle | None = None,
    start: Path | None = None,
    pose_only: bool = False,
    within: PriorTolerances | None = None,
    lens: LensType | None = None,
    plots: Path | None = None,
) -> dict[str, Any]:
    """Fit a file of sightings, draw the result into a folder where one is named, and return the document.

    `start` is of any format that is read; `pose_only` keeps the lens of the calibration document `start` and fits its
    pose alone; `within` makes `start` a prior of these tolerances; `lens` is the camera's type of lens, in place of
    `start`. A projection that is not known comes from `start`, or is chosen by the sightings.
    """
    if plots is not None:
        extra_module("matplotlib", extra="studies")  # before the fit, which takes minutes
    points = read_points(path, image_size)
    if lens is not None:
        require_lens(lens, image_size=image_size, options=options, known=projection_known)
        solved, points = calibrate_with_lens(points, lens=lens, site=site, options=options, circle=circle)
    elif start is not None and pose_only:
        known = read_calibration(start)
        _require_size(known.camera, image_size)
        solved = estimate_pose(points, start=known, site=site, options=options)
    elif start is not None and within is not None:
        prior = _start_camera(start, image_size, options, posed=within.pose_deg is not None)
        solved = calibrate_with_prior(points, prior=prior, tolerances=within, site=site, options=options)
    elif start is None and not projection_known:
        solved, points = calibrate_unknown_lens(
            points, site=site, image_size=image_size, options=options, circle=circle
        )
    else:
        begin = None if start is None else _start_camera(start, image_size, options)
        solved, points = calibrate_moved(
            points, site=site, image_size=image_size, options=options, circle=circle, start=begin
        )
    if plots is not None:
        from sunarc.studies.plots import write_calibration_plots  # noqa: PLC0415 - the plot library is slow to load

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


def read_points(path: Path, image_size: tuple[int, int]) -> SunPoints:
    """Return a CSV file's sightings; InputError where they are of images of another size, or the file is none."""
    table = read_sightings(read_lines(path), name=path.name)
    require_inside(table.pixels, image_size, name=path.name)
    return SunPoints(
        unix_s=table.unix_s,
        pixels=table.pixels,
        sigma_px=table.sigma_px,
        temperature=table.temperature,
        pressure=table.pressure,
        directions=table.directions,
        kind=kinds_of(table.body),
    )


def _start_camera(
    path: Path, image_size: tuple[int, int], options: CalibrationOptions, *, posed: bool = False
) -> Camera:
    """Return the camera to begin at: that of a document, or the one closest to what a file of another format says.

    `posed` requires that the file has a pose.
    """
    view = read_view_file(path)
    if posed and not view.has_pose:
        raise InputError(
            field="--pose-within", problem=f"{path.name} has no pose", remedy="leave it out: the pose is sought anew"
        )
    camera = view.camera
    if camera is None:
        closest, _ = closest_camera(view, projection=options.projection)
        camera = replace(closest, max_angle=math.radians(options.max_angle_deg))
    _require_size(camera, image_size)
    if options.mirrored != "auto" and camera.mirrored != (options.mirrored == "yes"):
        hands = ("not mirrored", "mirrored")
        raise InputError(
            field="--start",
            problem=f"is {hands[camera.mirrored]}, where --mirrored {options.mirrored} is set",
            remedy="set --mirrored auto, or name a camera of this handedness",
        )
    return camera


def _require_size(camera: Camera, image_size: tuple[int, int]) -> None:
    """Raise InputError where a start is of other images: it would be no answer."""
    size = (camera.width, camera.height)
    if size != image_size:
        raise InputError(
            field="--start",
            problem=f"is of {size[0]}x{size[1]} images, not {image_size[0]}x{image_size[1]}",
            remedy="name a calibration of this camera",
        )


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
