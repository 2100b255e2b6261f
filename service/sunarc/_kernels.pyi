"""The compiled loops (service/kernels): arrays in C order and of exactly these types; anything else is a TypeError.

They run without the interpreter's lock and start no threads. Results are new arrays.
"""

from sunarc.array_types import FloatArray

def pixels_of(
    vector: FloatArray, code: int, mirror: float, max_angle: float, rotation: FloatArray, directions: FloatArray
) -> FloatArray:
    """Return (n, 2) pixels of directions (n, 3): `optics.forward.project` for the 23 parameters of `vector`.

    Parameters
    ----------
    code : of the projection. mirror : width - 1 of a mirrored image, negative for one that is not.
    max_angle : angle off the axis up to which the lens shows anything, rad; NaN beyond.
    rotation : (3, 3) to the camera's frame.

    Raises
    ------
    ValueError : no projection has this code.
    """

def pixels_and_rows_of(
    vector: FloatArray,
    code: int,
    mirror: float,
    max_angle: float,
    rotation: FloatArray,
    jacobian: FloatArray,
    directions: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return pixels (n, 2) and their derivatives by the 23 parameters (n, 2, 23), which are 0 where there is no pixel.

    `jacobian` (3, 3) is the right Jacobian of the rotation vector; the rest as of `pixels_of`.
    """

def rotation_and_jacobian(vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rotation matrix and the right Jacobian, (3, 3) each, of a rotation vector (3,), rad."""
