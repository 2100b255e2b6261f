"""The lens prior file: a prior of a type of lens, as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from sunarc.calibration.lens_library.lens_type import LENS_NAMES, LensType, UnitSpread
from sunarc.calibration.solve.priors import N_LENS
from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError
from sunarc.optics.camera import Camera

LENS_SCHEMA = "sunarc.lens-prior/1"


def lens_type_to_json(lens: LensType, *, software_version: str) -> dict[str, Any]:
    """Return the lens prior file's content; the principal point is relative to the image's centre."""
    camera, center = lens.camera, _image_center(lens.camera)
    return {
        "schema": LENS_SCHEMA,
        "image": {"width": camera.width, "height": camera.height, "mirrored": camera.mirrored},
        "lens": {
            "projection": camera.projection,
            "focal_length_px": list(camera.focal_length_px),
            "skew_px": camera.skew_px,
            "principal_point_from_center_px": [c - m for c, m in zip(camera.principal_point_px, center, strict=True)],
            "radial": list(camera.radial),
            "decentering": list(camera.decentering),
            "max_angle_deg": math.degrees(camera.max_angle),
        },
        "uncertainty": {
            "parameters": list(LENS_NAMES),
            "covariance": lens.covariance.tolist(),
            "field": {"amplitude_px": lens.field_px, "length_px": lens.field_length_px},
        },
        "spread": asdict(lens.spread),
        "provenance": {"cameras": list(lens.cameras), "days": list(lens.days)},
        "software": {"name": "sunarc", "version": software_version},
    }


def _image_center(camera: Camera) -> tuple[float, float]:
    return (camera.width - 1) / 2.0, (camera.height - 1) / 2.0


def read_lens_type(content: bytes, *, name: str) -> LensType:
    """Return the type of lens that a lens prior file holds; InputError names the file and the fault."""
    try:
        return lens_type_from_json(json.loads(content))
    except (ValueError, RecursionError):
        remedy = "name a file of sunarc calibrate --write-lens-prior"
        raise InputError(field=name, problem="is not JSON", remedy=remedy) from None
    except InputError as error:
        raise InputError(field=f"{name}, {error.field}", problem=error.problem, remedy=error.remedy) from None


def lens_type_from_json(document: object) -> LensType:
    """Return the type of lens that a lens prior file's content states.

    Raises
    ------
    InputError
        Names what is missing or not what it should be.
    """
    if not isinstance(document, Mapping) or document.get("schema") != LENS_SCHEMA:
        found = document.get("schema") if isinstance(document, Mapping) else None
        raise InputError(
            field="schema", problem=f"{found!r}", remedy=f"give a {LENS_SCHEMA} file (--write-lens-prior makes one)"
        )
    try:
        return _parse_document(document)
    except KeyError as missing:
        raise InputError(field=str(missing.args[0]), problem="missing", remedy="give a whole lens prior file") from None
    except (TypeError, ValueError, OverflowError) as fault:
        raise InputError(field="lens prior", problem=str(fault), remedy="give a whole lens prior file") from None


def _parse_document(document: Mapping[str, Any]) -> LensType:
    image, lens, uncertainty = document["image"], document["lens"], document["uncertainty"]
    size = int(image["width"]), int(image["height"])
    offset = [float(one) for one in lens["principal_point_from_center_px"]]
    camera = Camera(
        width=size[0],
        height=size[1],
        projection=lens["projection"],
        focal_length_px=_parse_pair(lens["focal_length_px"]),
        principal_point_px=_parse_pair([(n - 1) / 2.0 + o for n, o in zip(size, offset, strict=True)]),
        rotation_cam_enu=(0.0, 0.0, 0.0),
        skew_px=float(lens["skew_px"]),
        radial=tuple(float(one) for one in lens["radial"]),
        decentering=tuple(float(one) for one in lens["decentering"]),
        mirrored=bool(image["mirrored"]),
        max_angle=math.radians(float(lens["max_angle_deg"])),
    )
    provenance, field = document["provenance"], uncertainty["field"]
    return LensType(
        camera=camera,
        covariance=_parse_covariance(uncertainty),
        spread=UnitSpread(**document["spread"]),
        field_px=_require_nonnegative("uncertainty.field.amplitude_px", field["amplitude_px"]),
        field_length_px=_require_nonnegative("uncertainty.field.length_px", field["length_px"]),
        cameras=tuple(str(one) for one in provenance["cameras"]),
        days=tuple(str(one) for one in provenance["days"]),
    )


def _parse_pair(values: object) -> tuple[float, float]:
    first, second = (float(one) for one in values)  # type: ignore[attr-defined]
    return first, second


def _require_nonnegative(key: str, value: object) -> float:
    number = float(value)  # type: ignore[arg-type]
    if not (math.isfinite(number) and number >= 0.0):
        raise InputError(field=key, problem=f"{number} is not allowed", remedy="give a number of at least 0")
    return number


def _parse_covariance(uncertainty: Mapping[str, Any]) -> FloatArray:
    """Return (17, 17), checked: finite, symmetric and positive definite."""
    key = "uncertainty.covariance"
    if tuple(uncertainty["parameters"]) != LENS_NAMES:
        raise InputError(field="uncertainty.parameters", problem="not the lens's 17", remedy=", ".join(LENS_NAMES))
    matrix = np.array(uncertainty["covariance"], dtype=np.float64)
    if matrix.shape != (N_LENS, N_LENS) or not np.all(np.isfinite(matrix)):
        raise InputError(field=key, problem="not 17 rows of 17 finite numbers", remedy="give a whole lens prior file")
    root = np.sqrt(np.abs(np.diag(matrix)))
    if not np.allclose(matrix, matrix.T) or np.any(np.diag(matrix) <= 0.0):
        raise InputError(field=key, problem="not a covariance", remedy="give a whole lens prior file")
    if np.linalg.eigvalsh(matrix / root / root[:, None])[0] < -1e-9:
        raise InputError(field=key, problem="not positive", remedy="give a whole lens prior file")
    return np.asarray(0.5 * (matrix + matrix.T))
