"""Cameras of one type of lens, and epochs of each, in one fit: a TOML file in, a folder of documents out."""

from __future__ import annotations

import json
import re
import tomllib
import uuid
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import sunarc
from sunarc.calibration.lens_library.joint import Entry, calibrate_jointly
from sunarc.calibration.lens_library.lens_type import UnitSpread
from sunarc.calibration.model.document import to_document
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.errors import InputError
from sunarc.offline.calibrate_files import read_points
from sunarc.offline.files import read_file
from sunarc.offline.lens_priors import write_lens_prior
from sunarc.runtime.clock import Clock
from sunarc.sky.site import Site
from sunarc.utc import utc_time

_SITE = tuple(field.name for field in fields(Site))
_FIT = ("projection", "mirrored", "level_within_deg")
_COMMON = {*_SITE, *_FIT, "image_size"}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._ -]{0,63}")
LENS_FILE = "lens-prior.json"


class JointSpec(NamedTuple):
    """What a file asks for: the entries, and the stated spread between units; None where it states none."""

    entries: list[Entry]
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
    for entry, solved in zip(spec.entries, joint.calibrations, strict=True):
        times = entry.points.unix_s
        document = to_document(
            solved,
            id=uuid.uuid4().hex,
            camera=entry.camera,
            state="candidate" if solved.verdict.accepted else "refused",
            created_at=now,
            valid_from=utc_time(float(times.min())) if times.size else now,
            valid_until=None,
            pose_epoch=entry.epoch,
            software_version=sunarc.__version__,
        )
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
    except ValueError as error:
        raise InputError(field=str(path), problem=f"is no TOML ({error})", remedy="correct it") from None
    entries = tables.pop("entry", None)
    spread = tables.pop("spread", None)
    _refuse_unknown(path.name, tables, _COMMON)
    if not isinstance(entries, list) or not entries:
        raise InputError(field=path.name, problem="names no entry", remedy="give [[entry]] with camera and file")
    found = [_entry(f"{path.name}, entry {number}", one, tables, path.parent) for number, one in enumerate(entries, 1)]
    names = [(entry.camera, entry.epoch) for entry in found]
    for camera, epoch in names:
        if names.count((camera, epoch)) > 1:
            raise InputError(
                field=f"{path.name}, {camera}",
                problem=f"two entries of the epoch {epoch!r}",
                remedy="name the epochs differently",
            )
    return JointSpec(found, None if spread is None else _converted(f"{path.name}, spread", UnitSpread, spread))


def _entry(where: str, given: object, common: Mapping[str, Any], folder: Path) -> Entry:
    if not isinstance(given, dict):
        raise InputError(field=where, problem="is no table", remedy="give [[entry]] with camera and file")
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
    points = read_points(folder / str(values["file"]), size)
    return Entry(camera=camera, epoch=epoch, points=points, site=site, image_size=size, options=options)


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
