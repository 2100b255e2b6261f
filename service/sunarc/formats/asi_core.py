"""asi_core's camera file: Scaramuzza's model in YAML, and the mask of the pixels that show the sky.

asi_core reads four coefficients from a pixel to a ray, c, d and e; parts of it leave the affine ones out, so they are
held at c = 1 (-1 for a mirrored image) and d = e = 0. Rows come first, see `ocam`.
Reference: asi_core's own schema and loader, https://github.com/DLR-SF/Sky-Imaging.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sunarc.calibration.answers.direction_table import BackProjectionMap, back_projection_map, lookup
from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.errors import InputError
from sunarc.common.extras import extra_module
from sunarc.formats.calibration_document import from_document
from sunarc.formats.exported import FAR_FUTURE, FAR_PAST, Exported, file_notes
from sunarc.formats.matlab import matlab_bytes, read_variables
from sunarc.formats.ocam import OcamModel, ocam_model, ocam_view
from sunarc.formats.view import View, camera_view, compare
from sunarc.imaging.preview import decoded

_HORIZON_DEG = 90.0
_NEEDED = ("ss", "xc", "yc", "c", "d", "e", "width", "height")
_SCHEMA = "give a camera file of asi_core's schema of 2025 (camera_data.schema.yaml)"


def asi_core_yaml(
    model: OcamModel, *, width: int, height: int, camera: dict[str, str | float], notes: list[str]
) -> bytes:
    """Return asi_core's camera file.

    Parameters
    ----------
    model : a cubic one.
    width, height : px.
    camera : camera_name, mounted, demounted, latitude, longitude, altitude, camera_mask_file,
        celestial_coordinate_masks (empty without masks).
    notes : what is said at its top.
    """
    alpha, beta, gamma = Rotation.from_matrix(model.rotation.T).as_euler("XYZ")  # their R is Rx(α) Ry(β) Rz(γ)
    row, column = model.center_row_column
    c, d, e = model.affine
    diameter = round(2.0 * float(np.polynomial.polynomial.polyval(0.0, model.ray_to_pixel)))
    lines = [
        *(f"# {note}" for note in notes),
        f"camera_name: {_quote_text(camera['camera_name'])}",
        "camera_model: 'unknown'  # a calibration document does not say it",
        *(f"{name}: !!timestamp '{camera[name]}'" for name in ("mounted", "demounted")),
        *(f"{name}: {camera[name]!r}" for name in ("latitude", "longitude", "altitude")),
        "timezone: 'GMT+0'  # of image times; the service's are UTC",
        "min_ele_evaluated: 0.0",
        "internal_calibration:",
        f"  ss: [{_format_numbers(model.pixel_to_ray)}]",
        f"  invpol: [{_format_numbers(model.ray_to_pixel)}]",
        f"  xc: {row:.9f}  # the centre's row: asi_core's x runs down the image",
        f"  yc: {column:.9f}  # the centre's column",
        f"  c: {c:.12f}",
        f"  d: {d:.12f}",
        f"  e: {e:.12f}",
        f"  width: {width}",
        f"  height: {height}",
        f"  diameter: {diameter}  # of the horizon of a level camera, px",
        f"external_orientation: [{alpha:.12f}, {beta:.12f}, {gamma:.12f}]",
        f"camera_mask_file: {_quote_text(camera['camera_mask_file'])}  # next to this file; 1 where a pixel is sky",
    ]
    if angles := camera["celestial_coordinate_masks"]:
        lines.append(f"celestial_coordinate_masks: {_quote_text(angles)}  # AngleMatrix with ELE and AZ, radians")
    return ("\n".join(lines) + "\n").encode()


def read_asi_core(content: bytes, *, name: str, beside: Callable[[str], bytes | None]) -> View:
    """Return the view of a camera file of asi_core.

    Parameters
    ----------
    content, name : the file and what it is called.
    beside : returns a file that it names, its mask; None where that is missing, which its loader allows, too.

    Raises
    ------
    InputError
        It is of another schema (asi_core's names no version), its polynomial has not four coefficients, or its mask is
        of another size than its images.
    """
    yaml = extra_module("yaml", extra="formats")
    try:
        camera = yaml.safe_load(content)
        inner, orientation = camera["internal_calibration"], camera["external_orientation"]
        values = {key: inner[key] for key in _NEEDED}
        numbers = np.array([*(values[key] for key in _NEEDED[1:]), *orientation], dtype=np.float64)
        ss, invpol = (np.asarray(inner.get(key, []), dtype=np.float64) for key in ("ss", "invpol"))
    except (yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise InputError(field=name, problem=f"another schema than asi_core's ({error})", remedy=_SCHEMA) from None
    if ss.shape != (4,) or numbers.shape != (10,):
        problem = f"{ss.size} coefficients in ss and {numbers.size - 7} angles, where asi_core reads 4 and 3"
        raise InputError(field=name, problem=problem, remedy=_SCHEMA)
    xc, yc, c, d, e, width, height = numbers[:7]
    called = mask_file(content)
    _require_mask_size(None if called is None else beside(called), (int(height), int(width)), name=name)
    model = OcamModel(
        pixel_to_ray=ss,
        ray_to_pixel=invpol,
        center_row_column=np.array([xc, yc]),
        affine=np.array([c, d, e]),
        rotation=Rotation.from_euler("XYZ", numbers[7:]).as_matrix().T,
    )
    return ocam_view("asi-core", model, size=(int(width), int(height)))


def mask_file(content: bytes) -> str | None:
    """Return the name of the mask that a camera file names."""
    found = re.search(rb"^camera_mask_file:\s*['\"]?([^'\"#\n]+?)['\"]?\s*(#.*)?$", content, re.MULTILINE)
    return None if found is None else found.group(1).decode()


def _require_mask_size(mask: bytes | None, size: tuple[int, int], *, name: str) -> None:
    if mask is None:
        return
    try:
        found = read_variables(mask, ("Mask",))["Mask"]
        shape = np.shape(found[0] if isinstance(found, list) else found[0][0][0])
    except (ValueError, IndexError) as error:
        problem = f"its mask is not a MATLAB array Mask ({error})"
        raise InputError(field=name, problem=problem, remedy="write it again") from None
    if shape != size:
        problem = f"its mask is {shape[-1]}x{shape[0]} px, its images {size[1]}x{size[0]}"
        raise InputError(field=name, problem=problem, remedy="give the mask of these images")


_MASK_PNG = "_mask.png"


def asi_core_mask(found: BackProjectionMap) -> NDArray[np.uint8]:
    """Return the mask (height, width): 1 where a pixel looks above the horizon."""
    with np.errstate(invalid="ignore"):
        return np.asarray(found.zenith_deg <= _HORIZON_DEG).astype(np.uint8)


def mask_files(mask: NDArray[np.uint8], *, stem: str) -> dict[str, bytes]:
    """Return the mask's files: `Mask[0][0][0]` of a MATLAB file, as asi_core reads it, and a PNG of 0 and 255."""
    png = cv2.imencode(".png", 255 * mask)[1].tobytes()
    return {f"{stem}_mask.mat": matlab_bytes({"Mask": mask[None, None, None]}), f"{stem}{_MASK_PNG}": png}


def leave_out_obstructions(exported: Exported, hidden: BoolArray) -> Exported:
    """Return a camera file whose mask leaves out the pixels (height, width) that are hidden from the sky."""
    (name,) = (name for name in exported.beside if name.endswith(_MASK_PNG))
    free = np.asarray((np.asarray(decoded(exported.beside[name])) > 0) & ~hidden).astype(np.uint8)
    return replace(exported, beside={**exported.beside, **mask_files(free, stem=name.removesuffix(_MASK_PNG))})


def matrix_files(found: BackProjectionMap, *, camera: str, time: str) -> dict[str, bytes]:
    """Return the azimuth and elevation of every pixel as asi_core's own calibration writes them, and as it reads them.

    Single precision, radians; azimuth counter-clockwise from east (pi/2 - azimuth, within ±pi); NaN at and below the
    horizon. `AngleMatrix` of the MATLAB file has the fields ELE and AZ.
    """
    east, north, up = np.moveaxis(found.directions, -1, 0)
    with np.errstate(invalid="ignore"):
        elevation = np.where(up > 0.0, np.arctan2(up, np.hypot(east, north)), np.nan).astype(np.float32)
        azimuth = np.where(up > 0.0, np.arctan2(north, east), np.nan).astype(np.float32)
    angles = {"ELE": elevation, "AZ": azimuth}
    files = {f"angle_matrix_{camera}_{time}.mat": matlab_bytes({"AngleMatrix": angles})}
    for name, matrix in (("azimuth", azimuth), ("elevation", elevation)):
        target = io.BytesIO()
        np.save(target, matrix, allow_pickle=False)
        files[f"{name}_matrix_{camera}_{time}.npy"] = target.getvalue()
    return files


def _quote_text(text: str | float) -> str:
    return "'" + str(text).replace("'", "''") + "'"


def _format_numbers(values: FloatArray) -> str:
    return ", ".join(f"{value:.17e}" for value in values)


Document = Mapping[str, Any]

_RANK = {"candidate": 1, "retired": 2, "current": 3}
"""Which of an epoch's calibrations is chosen: the highest, then the newest."""


def asi_core_file(calibration: Calibration, document: Document, *, with_matrices: bool = False) -> Exported:
    """Return the camera file of a calibration, with its mask and, where they are wanted, its matrices as companions."""
    camera, model = calibration.camera, ocam_model(calibration.camera, cubic=True)
    error = compare(camera_view(camera), ocam_view("asi-core", model, size=(camera.width, camera.height)))
    mounted = document["valid_from"] or FAR_PAST
    name, time = _require_plain_name(document["camera"]), re.sub(r"[^0-9]", "", mounted)[:14]
    found = back_projection_map(lookup(calibration))
    masks = mask_files(asi_core_mask(found), stem=f"{name}_{time}")
    matrices = matrix_files(found, camera=name, time=time) if with_matrices else {}
    notes = [
        *file_notes(document),
        f"this model {error}",
        "four coefficients can do no more: the matrices of azimuth and elevation of a set are exact",
        "asi_core's own azimuth matrix is counted in radians counter-clockwise from east: it is pi/2 - azimuth",
        "its object coordinates are (north, east, up); its x_center is the row, its y_center the column",
    ]
    site = {
        "camera_name": str(document["camera"]),
        "camera_mask_file": min(masks),
        "celestial_coordinate_masks": min(matrices, default=""),
        "mounted": mounted,
        "demounted": document["valid_until"] or FAR_FUTURE,
        **{name: float(document["site"][name]) for name in ("latitude", "longitude", "altitude")},
    }
    content = asi_core_yaml(model, width=camera.width, height=camera.height, camera=site, notes=notes)
    return Exported(
        content=content,
        error=str(error),
        difference=error.total,
        name=f"{name}_{time}.yaml",
        beside=masks | matrices,
    )


def asi_core_set(documents: Sequence[Document]) -> list[Exported]:
    """Return one camera file for each pose epoch of each camera, with its mask and matrices, in order of time.

    An epoch's file is that of its current calibration, or the last retired one; refused ones count only where there is
    nothing else. It is mounted from the start of the epoch to that of the next one, so that no two overlap.

    Raises
    ------
    InputError
        A document is missing or invalid.
    """
    if not documents:
        raise InputError(field="calibrations", problem="there is none", remedy="name calibration documents")
    calibrations = {id(document): from_document(document) for document in documents}
    made = []
    for camera in sorted({str(document["camera"]) for document in documents}):
        chosen = _split_by_epoch([document for document in documents if document["camera"] == camera])
        made += [asi_core_file(calibrations[key], document, with_matrices=True) for key, document in chosen]
    return made


def _split_by_epoch(documents: Sequence[Document]) -> list[tuple[int, Document]]:
    """Return the chosen document of each epoch of a camera with the epoch's own validity, and the identity it had."""
    usable = [document for document in documents if document["state"] != "refused"] or list(documents)
    epochs: dict[str, list[Document]] = {}
    for document in usable:
        epochs.setdefault(str(document["pose_epoch"]), []).append(document)
    starts = sorted((min(document["valid_from"] or "" for document in group), name) for name, group in epochs.items())
    chosen: list[tuple[int, Document]] = []
    for (start, name), following in pairwise([*starts, ("", "")]):
        group = epochs[name]
        best = max(group, key=lambda one: (_RANK.get(one["state"], 0), one["created_at"]))
        ends = [document["valid_until"] for document in group]
        last = None if None in ends else max(ends)
        validity = {"valid_from": start or None, "valid_until": following[0] or last}
        chosen.append((id(best), {**best, **validity}))
    return chosen


def _require_plain_name(name: object) -> str:
    """Return a name that is a plain file name."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", str(name))
