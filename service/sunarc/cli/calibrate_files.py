"""Calibrations from CSV files: of one camera, of several of a lens type, and with a prior of the type."""

from __future__ import annotations

import json
import math
import re
import tomllib
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import sunarc
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.change_points import calibrate_moved
from sunarc.calibration.lens_library.first_pose import calibrate_with_lens
from sunarc.calibration.lens_library.joint import Entry, Unit, calibrate_jointly, lens_type_of
from sunarc.calibration.lens_library.lens_type import LensType, UnitSpread
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle, Mirrored
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.pose import estimate_pose
from sunarc.calibration.quality.fit_checks import provisional
from sunarc.calibration.quality.tilt import require_level
from sunarc.calibration.quality.widening import with_clock
from sunarc.calibration.stated_prior import PriorTolerances, calibrate_with_prior
from sunarc.cli.calibration_files import read_calibration, read_view_file
from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError
from sunarc.common.extras import extra_module
from sunarc.common.findings import Finding
from sunarc.common.utc import utc_time
from sunarc.formats.calibration_document import from_document, to_document
from sunarc.formats.csv_files import read_sightings
from sunarc.formats.lens_prior import lens_type_to_json
from sunarc.formats.view import closest_camera
from sunarc.imager.runtime.clock import Clock
from sunarc.imaging.image_circle import find_image_circle
from sunarc.optics.camera import Camera
from sunarc.sky.site import Site
from sunarc.sources.files import read_file, read_image, read_lines, require_inside


def write_lens_prior(path: Path, lens: LensType) -> None:
    """Write a lens prior file."""
    content = lens_type_to_json(lens, software_version=sunarc.__version__)
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def combined_lens(documents: Sequence[dict[str, Any]], files: Sequence[Path], *, spread: UnitSpread | None) -> LensType:
    """Return what calibration documents, and files of such, say of one type of lens.

    Raises
    ------
    InputError
        Where a file is no calibration document, a calibration is refused or was given a lens prior itself, a camera is
        named twice, or two are of different types of lens.
    """
    units: dict[str, Unit] = {}
    for document in (*documents, *map(_json, files)):
        unit = _unit(document)
        if unit.camera in units:
            raise InputError(
                field=unit.camera, problem="two calibrations of one camera", remedy="name its best one, or fit --joint"
            )
        units[unit.camera] = unit
    return lens_type_of(list(units.values()), spread=spread)


def require_lens(lens: LensType, *, image_size: tuple[int, int], options: CalibrationOptions) -> None:
    """Raise InputError where a camera cannot be of a type of lens.

    Parameters
    ----------
    lens : the type.
    image_size : of the camera, px.
    options : of its fit.
    """
    camera = lens.camera
    hand = "yes" if camera.mirrored else "no"
    for what, given, stated in (
        ("image size", image_size, (camera.width, camera.height)),
        (
            "projection",
            camera.projection if options.projection == "auto" else options.projection,
            camera.projection,
        ),
        ("mirrored", options.mirrored if options.mirrored in {"no", "yes"} else hand, hand),
    ):
        if given != stated:
            raise InputError(
                field="--lens-prior",
                problem=f"{what} {stated}, where the camera's is {given}",
                remedy="name the lens prior of this type of lens and sensor",
            )


def _unit(document: dict[str, Any]) -> Unit:
    calibration = from_document(document)
    name = str(document.get("camera", ""))
    if not calibration.verdict.accepted:
        raise InputError(field=name, problem="the calibration is refused", remedy="name accepted calibrations")
    if calibration.evidence.options.get("free", "all") != "all" or "lens_prior" in calibration.evidence.options:
        raise InputError(
            field=name,
            problem="the calibration was given its lens, and adds nothing to it",
            remedy="name a calibration that was fitted without --pose-only, --lens-within and --lens-prior",
        )
    return Unit(name, calibration)


def _json(path: Path) -> Any:  # noqa: ANN401 - JSON holds anything
    try:
        return json.loads(read_file(path))
    except (ValueError, RecursionError):
        raise InputError(field=str(path), problem="is not JSON", remedy="name a JSON file of sunarc") from None


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
    within: PriorTolerances | None = None,
    lens: LensType | None = None,
    plots: Path | None = None,
    keep_provisional: bool = False,
    clock_error_s: float | None = None,
) -> dict[str, Any]:
    """Fit a file of sightings, draw the result into a folder where one is named, and return the document.

    `start` is of any format that is read; `pose_only` keeps its lens, see `_posed`; `within` makes it a prior of these
    tolerances; `lens` is the camera's type of lens, in place of `start`. A projection that is not stated comes from
    `start`, or is chosen by the sightings. `keep_provisional`: see `provisional`. `clock_error_s`: the bound of the
    clock, where it is stated; that of the file's column clock_error_s unless given.
    """
    if plots is not None:
        extra_module("matplotlib", extra="plots")  # before the fit, which takes minutes
    points, clock_error_s = _without_clock_column(read_points(path, image_size, site), clock_error_s)
    known = None if start is None else _accepted_here(start, site)
    if known is not None:
        require_level(known.pose.theta_zz_deg, options.level_within_deg, field="--level-within", name=str(start))
    if lens is not None:
        require_lens(lens, image_size=image_size, options=options)
        solved, points = calibrate_with_lens(points, lens=lens, site=site, options=options, circle=circle)
    elif start is not None and pose_only:
        solved = _posed(points, start, image_size=image_size, site=site, options=options)
    elif start is not None and within is not None:
        prior = start_camera(start, image_size, options, posed=within.pose_deg is not None)
        solved = calibrate_with_prior(points, prior=prior, tolerances=within, site=site, options=options)
    else:
        begin = None if start is None else start_camera(start, image_size, options)
        if begin is not None:  # the file states the handedness
            options = replace(options, mirrored="yes" if begin.mirrored else "no")
        solved, points = calibrate_moved(
            points,
            site=site,
            image_size=image_size,
            options=options,
            circle=circle,
            start=begin,
            tilt_known=known is not None,
        )
    if start is not None or lens is not None:
        solved = _explained(solved, points, options=options, circle=circle)
    if keep_provisional:
        solved = provisional(solved, limit_deg=options.max_sky_deg)
    solved = with_clock(solved, clock_error_s)
    if plots is not None:
        from sunarc.lab.studies.reports import write_calibration_plots

        write_calibration_plots(solved, points, folder=plots)
    since = points.unix_s[points.epoch == points.epoch.max()] if len(points) else points.unix_s
    return _document(solved, since, clock.now(), camera=path.stem)


_SAME_SITE_DEG = 0.1
"""Difference of latitude or longitude up to which a camera was accepted at the same site."""


def _accepted_here(start: Path, site: Site) -> Calibration | None:
    """Return the calibration of a file that was accepted at a site; None of another site, and of other formats."""
    if read_view_file(start).camera is None:
        return None
    known = read_calibration(start)
    off_deg = abs(known.site.latitude - site.latitude), abs(known.site.longitude - site.longitude)
    return known if known.verdict.accepted and max(off_deg) < _SAME_SITE_DEG else None


def _document(
    solved: Calibration, unix_s: FloatArray, now: datetime, *, camera: str, pose_epoch: str = ""
) -> dict[str, Any]:
    """Return the document of a calibration that is made now, valid since the first of its sightings' times (n,)."""
    return to_document(
        solved,
        id=uuid.uuid4().hex,
        camera=camera,
        state="candidate" if solved.verdict.accepted or solved.sigma_limit_deg is not None else "refused",
        created_at=now,
        valid_from=utc_time(float(unix_s.min())) if unix_s.size else now,
        valid_until=None,
        pose_epoch=pose_epoch,
        software_version=sunarc.__version__,
    )


def _explained(
    solved: Calibration, points: Sightings, *, options: CalibrationOptions, circle: ImageCircle | None
) -> Calibration:
    """Return a calibration by a known lens; its verdict says where the sightings alone fit the other handedness."""
    if solved.verdict.accepted or any(one.code.startswith("other_handedness") for one in solved.verdict.findings):
        return solved
    stated: Mirrored = "yes" if solved.camera.mirrored else "no"
    size = (solved.camera.width, solved.camera.height)
    free = replace(options, mirrored="auto", projection=solved.camera.projection)
    alone = calibrate(points, site=solved.site, image_size=size, options=free, circle=circle)
    if not alone.verdict.accepted or alone.camera.mirrored == solved.camera.mirrored:
        return solved
    other: Mirrored = "no" if stated == "yes" else "yes"
    found = Finding("other_handedness_fits", {"mirrored": other, "stated": stated, "latitude": -solved.site.latitude})
    return replace(solved, verdict=replace(solved.verdict, findings=(found, *solved.verdict.findings)))


_LENS_WITHIN_PX, _LARGEST_LENS_PX = 1.0, 10.0
"""1-sigma of the image near the horizon by a lens of which a file states no uncertainty; no lens is kept by more."""


def _posed(
    points: Sightings, start: Path, *, image_size: tuple[int, int], site: Site, options: CalibrationOptions
) -> Calibration:
    """Return the lens of a file in the pose that sightings ask for.

    That of a calibration document is kept within its own uncertainty; that of another format, which states none, within
    a pixel, and as far as our model differs from its description.
    """
    view = read_view_file(start)
    if view.camera is not None:
        known = read_calibration(start)
        _require_size(known.camera, image_size)
        return estimate_pose(points, start=known, site=site, options=options)
    camera, difference = closest_camera(view)
    _require_size(camera, image_size)
    lens_px = math.hypot(_LENS_WITHIN_PX, difference.total.rms_px)
    if not lens_px <= _LARGEST_LENS_PX:
        raise InputError(
            field="--pose-only",
            problem=f"the lens of {start.name} is none of ours to {difference.total.rms_px:.0f} px",
            remedy="name a calibration that describes the whole image",
        )
    camera = replace(camera, max_angle=math.radians(options.max_angle_deg))
    return calibrate_with_prior(
        points, prior=camera, tolerances=PriorTolerances(lens_px=lens_px), site=site, options=options
    )


def _without_clock_column(points: Sightings, clock_error_s: float | None) -> tuple[Sightings, float | None]:
    """Return sightings whose clock is one error of all, and its bound: that of the option, or the column's largest."""
    stated = points.clock_error_s[np.isfinite(points.clock_error_s)]
    if stated.size == 0:
        return points, clock_error_s
    largest_s = float(np.max(stated))
    if clock_error_s is not None and clock_error_s != largest_s:
        raise InputError(
            field="--clock-error",
            problem=f"{clock_error_s:g} s, where the column clock_error_s has {largest_s:g} s",
            remedy="leave out one of them",
        )
    return replace(points, clock_error_s=np.full(1, np.nan)), largest_s


def read_points(path: Path, image_size: tuple[int, int], site: Site) -> Sightings:
    """Return a CSV file's sightings; InputError where they are of images of another size, or the file is none."""
    points = read_sightings(read_lines(path), name=path.name, site=site)
    require_inside(points.pixels, image_size, name=path.name)
    return points


def start_camera(
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
        closest, _ = closest_camera(view, projection=options.assumed_projection)
        camera = replace(closest, max_angle=math.radians(options.max_angle_deg))
    _require_size(camera, image_size)
    if options.projection not in {"auto", camera.projection}:
        raise InputError(
            field="--start",
            problem=f"its lens is {camera.projection}, where --projection {options.projection} is given",
            remedy="leave --projection out, or name a camera of this projection",
        )
    if options.mirrored in {"no", "yes"} and camera.mirrored != (options.mirrored == "yes"):
        hands = ("not mirrored", "mirrored")
        raise InputError(
            field="--start",
            problem=f"is {hands[camera.mirrored]}, where --mirrored {options.mirrored} is set",
            remedy="leave --mirrored out, or name a camera of this handedness",
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
        x, y, radius = found
    return ImageCircle(x=x, y=y, radius=radius)


_SITE = tuple(field.name for field in fields(Site))
_FIT = ("projection", "mirrored", "level_within_deg")
_COMMON = {*_SITE, *_FIT, "image_size"}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._ -]{0,63}")
LENS_FILE = "lens-prior.json"


class JointSpec(NamedTuple):
    """What a file asks for: the entries, the bound of each one's clock in s, and the spread between units.

    None where no bound, and no spread, is stated.
    """

    entries: list[Entry]
    clock_errors_s: list[float | None]
    spread: UnitSpread | None


def calibrate_joint(path: Path, *, folder: Path, clock: Clock) -> list[dict[str, Any]]:
    """Fit the entries of a file together, write each's document and the lens prior to a folder, return the documents.

    The files are CAMERA.json, or CAMERA-EPOCH.json where the entry names an epoch, and `lens-prior.json`, which is
    absent where no entry was accepted.

    Parameters
    ----------
    path : TOML: `[[entry]]` tables with `camera`, `file` and, where there are several of a camera, `epoch`; site,
        `image_size` and `projection` in each or once at the top; `[spread]` between units.
    folder : made where it is missing.
    clock : dates the calibrations.

    Raises
    ------
    InputError
        Names the entry or the key that is wrong.
    """
    spec = read_joint_spec(path)
    joint = calibrate_jointly(spec.entries, spread=spec.spread)
    documents = []
    folder.mkdir(parents=True, exist_ok=True)
    now = clock.now()
    for entry, clock_error_s, solved in zip(spec.entries, spec.clock_errors_s, joint.calibrations, strict=True):
        stated = with_clock(solved, clock_error_s)
        document = _document(stated, entry.points.unix_s, now, camera=entry.camera, pose_epoch=entry.epoch)
        name = "-".join(filter(None, (entry.camera, entry.epoch)))
        (folder / f"{name}.json").write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        documents.append(document)
    if joint.lens is not None:
        write_lens_prior(folder / LENS_FILE, joint.lens)
    return documents


def read_joint_spec(path: Path) -> JointSpec:
    """Return what a TOML file asks to fit together; InputError names the key that is wrong."""
    try:
        tables = tomllib.loads(read_file(path).decode())
    except (ValueError, RecursionError) as error:
        raise InputError(field=str(path), problem=f"is not TOML ({error})", remedy="correct it") from None
    entries = tables.pop("entry", None)
    spread = tables.pop("spread", None)
    _refuse_unknown(path.name, tables, _COMMON)
    if not isinstance(entries, list) or not entries:
        raise InputError(field=path.name, problem="names no entry", remedy="give [[entry]] with camera and file")
    found = [_entry(f"{path.name}, entry {number}", one, tables, path.parent) for number, one in enumerate(entries, 1)]
    names = [(entry.camera, entry.epoch) for entry, _ in found]
    for camera, epoch in names:
        if names.count((camera, epoch)) > 1:
            raise InputError(
                field=f"{path.name}, {camera}",
                problem=f"two entries of the epoch {epoch!r}",
                remedy="name the epochs differently",
            )
    between = None if spread is None else _converted(f"{path.name}, spread", UnitSpread, spread)
    return JointSpec([entry for entry, _ in found], [clock_error_s for _, clock_error_s in found], between)


def _entry(where: str, given: object, common: Mapping[str, Any], folder: Path) -> tuple[Entry, float | None]:
    """Return an entry, and the bound of its clock by the column clock_error_s, s; None without that column."""
    if not isinstance(given, dict):
        raise InputError(field=where, problem="is not a table", remedy="give [[entry]] with camera and file")
    _refuse_unknown(where, given, _COMMON | {"camera", "epoch", "file"})
    camera, epoch = (str(given.get(key, "")) for key in ("camera", "epoch"))
    for key, name in (("camera", camera), ("epoch", epoch or "none")):
        if not _NAME.fullmatch(name):
            raise InputError(field=f"{where}, {key}", problem=f"{name!r}", remedy="use letters, numbers, . _ and -")
    values = {**common, **given}
    for key in ("file", "latitude", "longitude", "image_size"):
        if key not in values:
            raise InputError(field=f"{where}, {key}", problem="missing", remedy="give it here or once for all")
    size = _converted(f"{where}, image_size", lambda w, h: (int(w), int(h)), values["image_size"])
    of_site = {"altitude": 0.0} | {key: values[key] for key in _SITE if key in values}
    of_fit = {key: values[key] for key in _FIT if key in values}
    site = _converted(where, Site, of_site)
    options = _converted(where, CalibrationOptions, of_fit)
    points, clock_error_s = _without_clock_column(read_points(folder / str(values["file"]), size, site), None)
    entry = Entry(camera=camera, epoch=epoch, points=points, site=site, image_size=size, options=options)
    return entry, clock_error_s


def _converted(where: str, convert: Any, given: Any) -> Any:  # noqa: ANN401 - TOML holds anything
    """Return what a table or a list of TOML means; InputError where it means nothing."""
    try:
        return convert(**given) if isinstance(given, dict) else convert(*given)
    except (TypeError, ValueError) as error:
        raise InputError(field=where, problem=str(error), remedy="see `sunarc calibrate --help`") from None


def _refuse_unknown(where: str, given: Mapping[str, Any], known: set[str]) -> None:
    unknown = sorted(set(given) - known)
    if unknown:
        raise InputError(
            field=where, problem=f"{', '.join(unknown)} is unknown", remedy=f"use {', '.join(sorted(known))}"
        )
