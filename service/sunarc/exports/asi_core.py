"""asi_core's camera file: Scaramuzza's model in YAML, and the mask of the pixels that show the sky.

asi_core reads four coefficients from a pixel to a ray, c, d and e; parts of it leave the affine ones out, so they are
held at c = 1 (-1 for a mirrored image) and d = e = 0. Rows come first, see `ocam`.
Reference: asi_core's own schema and loader, https://github.com/DLR-SF/Sky-Imaging.
"""

from __future__ import annotations

import io
import re

import numpy as np
import scipy.io
from scipy.spatial.transform import Rotation

from sunarc.array_types import FloatArray
from sunarc.calibration import BackProjectionMap
from sunarc.exports.ocam import OcamModel

_HORIZON_DEG = 90.0


def asi_core_yaml(
    model: OcamModel, *, width: int, height: int, camera: dict[str, str | float], notes: list[str]
) -> bytes:
    """Return asi_core's camera file.

    Parameters
    ----------
    model : a cubic one.
    width, height : px.
    camera : camera_name, mounted, demounted, latitude, longitude, altitude, camera_mask_file.
    notes : what is said at its top.
    """
    alpha, beta, gamma = Rotation.from_matrix(model.rotation.T).as_euler("XYZ")  # their R is Rx(α) Ry(β) Rz(γ)
    row, column = model.center_row_column
    c, d, e = model.affine
    diameter = round(2.0 * float(np.polynomial.polynomial.polyval(0.0, model.ray_to_pixel)))
    lines = [
        *(f"# {note}" for note in notes),
        f"camera_name: {_quoted(camera['camera_name'])}",
        "camera_model: 'unknown'  # a calibration document does not say it",
        *(f"{name}: !!timestamp '{camera[name]}'" for name in ("mounted", "demounted")),
        *(f"{name}: {camera[name]!r}" for name in ("latitude", "longitude", "altitude")),
        "timezone: 'GMT+0'  # of image times; the service's are UTC",
        "min_ele_evaluated: 0.0",
        "internal_calibration:",
        f"  ss: [{_numbers(model.pixel_to_ray)}]",
        f"  invpol: [{_numbers(model.ray_to_pixel)}]",
        f"  xc: {row:.9f}  # the centre's row: asi_core's x runs down the image",
        f"  yc: {column:.9f}  # the centre's column",
        f"  c: {c:.12f}",
        f"  d: {d:.12f}",
        f"  e: {e:.12f}",
        f"  width: {width}",
        f"  height: {height}",
        f"  diameter: {diameter}  # of the horizon of a level camera, px",
        f"external_orientation: [{alpha:.12f}, {beta:.12f}, {gamma:.12f}]",
        f"camera_mask_file: {_quoted(camera['camera_mask_file'])}  # beside this file; 1 where a pixel shows the sky",
    ]
    return ("\n".join(lines) + "\n").encode()


def mask_name(camera: str) -> str:
    """Return the name of a camera's mask file."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", camera) + "_mask.mat"


def mask_mat(found: BackProjectionMap) -> bytes:
    """Return the mask as asi_core reads it: `Mask[0][0][0]` of a MATLAB file, (height, width), 1 above the horizon."""
    with np.errstate(invalid="ignore"):
        shown = np.asarray(found.zenith_deg <= _HORIZON_DEG).astype(np.uint8)
    target = io.BytesIO()
    scipy.io.savemat(target, {"Mask": shown[None, None, None]}, do_compression=True)  # type: ignore[arg-type]
    return target.getvalue()


def _quoted(text: str | float) -> str:
    return "'" + str(text).replace("'", "''") + "'"


def _numbers(values: FloatArray) -> str:
    return ", ".join(f"{value:.17e}" for value in values)
