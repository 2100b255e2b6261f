"""Calibrations from CSV files: of one camera, of several of a lens type, and with a prior of the type."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import fields
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import sunarc
from sunarc.calibration.lens_library.joint import Entry, Unit, calibrate_jointly, estimate_lens_type
from sunarc.calibration.lens_library.lens_type import LensType, UnitSpread
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.stated_prior import PriorTolerances
from sunarc.calibration.verdict import add_stated_clock
from sunarc.common.errors import InputError
from sunarc.common.extras import extra_module
from sunarc.common.json_text import json_text
from sunarc.formats.calibration_document import from_document
from sunarc.formats.csv_files import read_sightings
from sunarc.formats.lens_prior import lens_type_to_json
from sunarc.public.documents import latest_times, new_document
from sunarc.public.stated_fit import StatedStart, fit_as_stated, without_clock_column
from sunarc.sky.site import Site
from sunarc.sources.files import read_file, read_image, read_lines, require_inside


def write_lens_prior(path: Path, lens: LensType) -> None:
    """Write a lens prior file."""
    path.write_text(json_text(lens_type_to_json(lens, software_version=sunarc.__version__)), encoding="utf-8")


def combined_lens(documents: Sequence[dict[str, Any]], files: Sequence[Path], *, spread: UnitSpread | None) -> LensType:
    """Return the combined lens of calibration documents, and of files of such, of one type of lens.

    Raises
    ------
    InputError
        Where a file is no calibration document, a calibration is refused or was given a lens prior itself, a camera is
        named twice, or two are of different types of lens.
    """
    units: dict[str, Unit] = {}
    for document in (*documents, *map(_read_json, files)):
        unit = _make_unit(document)
        if unit.camera in units:
            raise InputError(
                field=unit.camera, problem="two calibrations of one camera", remedy="name its best one, or fit --joint"
            )
        units[unit.camera] = unit
    return estimate_lens_type(list(units.values()), spread=spread)


def _make_unit(document: dict[str, Any]) -> Unit:
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


def _read_json(path: Path) -> Any:  # noqa: ANN401 - JSON holds anything
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
    now: datetime,
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

    The arguments are those of `fit_as_stated`; `start` is a file of any format that is read, `now` dates the document.
    """
    if plots is not None:
        extra_module("matplotlib", extra="plots")  # before the fit, which takes minutes
    solved, points = fit_as_stated(
        read_points(path, site),
        name=path.name,
        site=site,
        image_size=image_size,
        options=options,
        circle=circle,
        start=None if start is None else read_start(start),
        pose_only=pose_only,
        within=within,
        lens=lens,
        keep_provisional=keep_provisional,
        clock_error_s=clock_error_s,
    )
    if plots is not None:
        from sunarc.public.plots import write_calibration_plots  # noqa: PLC0415 - matplotlib is of an extra

        write_calibration_plots(solved, points, folder=plots)
    return new_document(solved, latest_times(points), created_at=now, camera=path.stem)


def read_points(path: Path, site: Site) -> Sightings:
    """Return a CSV file's sightings; InputError where the file is invalid."""
    return read_sightings(read_lines(path), name=path.name, site=site)


def read_start(path: Path) -> StatedStart:
    """Return the camera of a file of any format that is read."""
    from sunarc.public.calibration_files import read_view_file  # noqa: PLC0415 - the readers of all formats

    view = read_view_file(path)
    return StatedStart(path.name, view, view.calibration)


def parse_image_circle(text: str) -> ImageCircle:
    """Return the image circle that X,Y,RADIUS names, or that a normal daytime image shows (Hough transform)."""
    try:
        x, y, radius = (float(part) for part in text.split(","))
    except ValueError:
        from sunarc.imaging.image_circle import find_image_circle  # noqa: PLC0415 - OpenCV

        found = find_image_circle(read_image(Path(text)))
        if found is None:
            raise InputError(
                field="--image-circle", problem=f"{text} shows no image circle", remedy="give X,Y,RADIUS in px"
            ) from None
        x, y, radius = found
    return ImageCircle(x=x, y=y, radius=radius)


_SITE = tuple(field.name for field in fields(Site))
_FIT = ("projection", "mirrored", "level_within_deg", "outwards_px")
_COMMON = {*_SITE, *_FIT, "image_size"}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._ -]{0,63}")
LENS_FILE = "lens-prior.json"


class JointSpec(NamedTuple):
    """Request of a joint fit: the entries, the bound of each one's clock in s, and the spread between units.

    None where no bound, and no spread, is stated.
    """

    entries: list[Entry]
    clock_errors_s: list[float | None]
    spread: UnitSpread | None


def calibrate_joint(path: Path, *, folder: Path, now: datetime) -> list[dict[str, Any]]:
    """Fit the entries of a file together, write each's document and the lens prior to a folder, return the documents.

    The files are CAMERA.json, or CAMERA-EPOCH.json where the entry names an epoch, and `lens-prior.json`, which is
    absent where no entry was accepted.

    Parameters
    ----------
    path : TOML: `[[entry]]` tables with `camera`, `file` and, where there are several of a camera, `epoch`; site,
        `image_size` and `projection` in each or once at the top; `[spread]` between units.
    folder : made where it is missing.
    now : dates the calibrations.

    Raises
    ------
    InputError
        Names the entry or the key that is wrong.
    """
    spec = read_joint_spec(path)
    joint = calibrate_jointly(spec.entries, spread=spec.spread)
    documents = []
    folder.mkdir(parents=True, exist_ok=True)
    for entry, clock_error_s, solved in zip(spec.entries, spec.clock_errors_s, joint.calibrations, strict=True):
        stated = add_stated_clock(solved, clock_error_s)
        document = new_document(
            stated, entry.points.unix_s, created_at=now, camera=entry.camera, pose_epoch=entry.epoch
        )
        name = "-".join(filter(None, (entry.camera, entry.epoch)))
        (folder / f"{name}.json").write_text(json_text(document), encoding="utf-8")
        documents.append(document)
    if joint.lens is not None:
        write_lens_prior(folder / LENS_FILE, joint.lens)
    return documents


def read_joint_spec(path: Path) -> JointSpec:
    """Return the request of a TOML file to fit entries together; InputError names the key that is wrong."""
    try:
        tables = tomllib.loads(read_file(path).decode())
    except (ValueError, RecursionError) as error:
        raise InputError(field=str(path), problem=f"is not TOML ({error})", remedy="correct it") from None
    entries = tables.pop("entry", None)
    spread = tables.pop("spread", None)
    _refuse_unknown(path.name, tables, _COMMON)
    if not isinstance(entries, list) or not entries:
        raise InputError(field=path.name, problem="names no entry", remedy="give [[entry]] with camera and file")
    found = [
        _parse_entry(f"{path.name}, entry {number}", one, tables, path.parent) for number, one in enumerate(entries, 1)
    ]
    names = [(entry.camera, entry.epoch) for entry, _ in found]
    for camera, epoch in names:
        if names.count((camera, epoch)) > 1:
            raise InputError(
                field=f"{path.name}, {camera}",
                problem=f"two entries of the epoch {epoch!r}",
                remedy="name the epochs differently",
            )
    between = None if spread is None else _convert_value(f"{path.name}, spread", UnitSpread, spread)
    return JointSpec([entry for entry, _ in found], [clock_error_s for _, clock_error_s in found], between)


def _parse_entry(where: str, given: object, common: Mapping[str, Any], folder: Path) -> tuple[Entry, float | None]:
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
    size = _convert_value(f"{where}, image_size", lambda w, h: (int(w), int(h)), values["image_size"])
    of_site = {"altitude": 0.0} | {key: values[key] for key in _SITE if key in values}
    of_fit = {key: values[key] for key in _FIT if key in values}
    site = _convert_value(where, Site, of_site)
    options = _convert_value(where, CalibrationOptions, of_fit)
    points, clock_error_s = without_clock_column(read_points(folder / str(values["file"]), site), None)
    require_inside(points.pixels, size, name=Path(str(values["file"])).name)
    entry = Entry(camera=camera, epoch=epoch, points=points, site=site, image_size=size, options=options)
    return entry, clock_error_s


def _convert_value(where: str, convert: Any, given: Any) -> Any:  # noqa: ANN401 - TOML holds anything
    """Return the value of a table or a list of TOML; InputError where it has none."""
    try:
        return convert(**given) if isinstance(given, dict) else convert(*given)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(field=where, problem=str(error), remedy="see `sunarc calibrate --help`") from None


def _refuse_unknown(where: str, given: Mapping[str, Any], known: set[str]) -> None:
    unknown = sorted(set(given) - known)
    if unknown:
        raise InputError(
            field=where, problem=f"{', '.join(unknown)} is unknown", remedy=f"use {', '.join(sorted(known))}"
        )
