"""OCamCalib's `calib_results.txt`: both polynomials of Scaramuzza's model, centre, affine part and image size."""

from __future__ import annotations

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.errors import InputError
from sunarc.exports.ocam import FRAME, OcamModel, ocam_view
from sunarc.exports.view import View

_ROTATION = "R from east-north-up to (down the image, right, into the camera): "
_REMEDY = "give the file that the toolbox's exportData writes"


def calib_results(model: OcamModel, *, width: int, height: int, notes: list[str]) -> bytes:
    """Return OCamCalib's text file; its notes stand at the end, which readers ignore."""

    def counted(numbers: FloatArray) -> str:
        return " ".join([str(len(numbers)), *(f"{number:.17e}" for number in numbers)])

    row, column = model.center_row_column
    c, d, e = model.affine
    blocks = [
        ('polynomial coefficients for the DIRECT mapping function (from a pixel to a ray: "cam2world")',
         counted(model.pixel_to_ray)),
        ('polynomial coefficients for the inverse mapping function (from a ray to a pixel: "world2cam")',
         counted(model.ray_to_pixel)),
        ('center: "row" and "column", starting from 0 (C convention)', f"{row:.9f} {column:.9f}"),
        ('affine parameters "c", "d", "e"', f"{c:.12f} {d:.12f} {e:.12f}"),
        ('image size: "height" and "width"', f"{height} {width}"),
    ]  # fmt: skip
    text = "\n".join(f"#{title}\n\n{values}\n" for title, values in blocks)
    rotation = "; ".join(" ".join(f"{value:.12f}" for value in line) for line in model.rotation)
    return (text + "\n" + "".join(f"# {line}\n" for line in [*notes, _ROTATION + rotation])).encode()


def read_ocamcalib(content: bytes, *, name: str) -> View:
    """Return the view of an OCamCalib text file; it has a pose where sunarc wrote it.

    Raises
    ------
    InputError
        It is none: not five blocks of numbers, or as many as they count.
    """
    lines = [line.strip() for line in content.decode(errors="replace").splitlines()]
    turn = next((line.partition(_ROTATION)[2] for line in lines if _ROTATION in line), "")
    try:
        blocks = [np.array(line.split(), dtype=np.float64) for line in lines if line and not line.startswith("#")]
        rotation = np.array([row.split() for row in turn.split(";")], dtype=np.float64) if turn else FRAME
    except ValueError as error:
        raise InputError(field=name, problem=f"no OCamCalib text ({error})", remedy=_REMEDY) from None
    if len(blocks) < 5 or [len(one) for one in blocks[2:5]] != [2, 3, 2]:
        raise InputError(field=name, problem="not the five blocks of OCamCalib", remedy=_REMEDY)
    if any(one[0] != len(one) - 1 or len(one) < 3 for one in blocks[:2]):
        raise InputError(field=name, problem="a polynomial is not as long as it says", remedy=_REMEDY)
    pixel_to_ray, ray_to_pixel, center, affine, size = blocks[:5]
    model = OcamModel(
        pixel_to_ray=pixel_to_ray[1:],
        ray_to_pixel=ray_to_pixel[1:],
        center_row_column=center,
        affine=affine,
        rotation=rotation,
    )
    return ocam_view("ocamcalib", model, size=(int(size[1]), int(size[0])), has_pose=bool(turn))
