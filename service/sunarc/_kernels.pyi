"""The compiled loops (service/kernels): arrays in C order and of exactly these types; anything else is a TypeError.

They run without the interpreter's lock and start no threads. Results are new arrays.
"""

from sunarc.array_types import FloatArray, IntArray

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

def directions_of(
    code: int,
    mirror: float,
    limit: float,
    plane: FloatArray,
    radial: FloatArray,
    decentering: FloatArray,
    rotation: FloatArray,
    pixels: FloatArray,
) -> FloatArray:
    """Return the directions (n, 3) that pixels (n, 2) look at; NaN where there is none.

    Newton's method in the plane for the decentering, then in one dimension for the angle.

    Parameters
    ----------
    limit : largest angle off the axis, rad.
    plane : (5,) fx, fy, skew, x0, y0, px.
    radial, decentering : k2 … k9, p1 … p4.
    code, mirror, rotation : as of `pixels_of`.

    Raises
    ------
    ValueError : no projection has this code.
    """

def directions_from_table(
    constants: FloatArray, rotation: FloatArray, table: FloatArray, rounds: int, pixels: FloatArray
) -> tuple[FloatArray, bool]:
    """Return the directions (n, 3) that pixels (n, 2) look at; infinite where the table is too coarse, and if it is.

    Parameters
    ----------
    constants, table, rounds : (13,), (k, 8): see `optics.inverse_table.InverseTable`.
    """

def pixels_from_grid(
    grid: FloatArray, origin: FloatArray, step: FloatArray, pixels: FloatArray
) -> tuple[FloatArray, bool]:
    """Return pixels (n, 2) less the cubic splines (rows, columns, 2) there; infinite beyond the grid, and if any is.

    `origin` and `step` (2,) are the grid's, px.
    """

def back_projected(
    rotation: FloatArray,
    sheet: FloatArray,
    slope: FloatArray,
    rings_per_radian: float,
    width: float,
    height: float,
    pixels: FloatArray,
    directions: FloatArray,
) -> FloatArray:
    """Return (n, 7): the columns `answers.direction_table.BACK_PROJECTED` of pixels and their directions.

    Parameters
    ----------
    rotation : (3, 3) to the camera's frame.
    sheet, slope : (rings + 2, spokes + 3) and (rings + 2): `answers.direction_table.Lookup.log_sigma` and `slope`.
    """

def projected(
    rotation: FloatArray,
    sheets: FloatArray,
    rings_per_radian: float,
    width: float,
    height: float,
    pixels: FloatArray,
    directions: FloatArray,
) -> FloatArray:
    """Return (n, 7): the columns `answers.direction_table.PROJECTED` of directions and their pixels.

    `sheets` (rings + 2, spokes + 3, 3): `answers.direction_table.Lookup.log_factor`.
    """

def polar_values(constants: FloatArray, sheets: FloatArray, rings_per_radius: float, pixels: FloatArray) -> FloatArray:
    """Return (n, 2): the values at pixels (n, 2) of two sheets of splines (rings + 2, spokes + 3, 2)."""

def displacement_at(box: FloatArray, coefficients: FloatArray, pixels: FloatArray) -> FloatArray:
    """Return the displacements (n, 2) at pixels (n, 2), px; 0 beyond the box, NaN for NaN.

    Parameters
    ----------
    box : centre (x, y) and half-widths (x, y), px.
    coefficients : (2, orders of x, orders of y) of sine waves, px.
    """

def displacement_and_slopes(
    box: FloatArray, coefficients: FloatArray, pixels: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return what `displacement_at` does, and its derivatives (n, 2, 2), last axis the pixel's."""

def displacement_inverse(box: FloatArray, coefficients: FloatArray, pixels: FloatArray) -> FloatArray:
    """Return (n, 2): what is displaced to pixels (n, 2), by Newton's method; NaN where that does not converge."""

def waves_at(pixels: FloatArray, box: FloatArray, orders: IntArray) -> FloatArray:
    """Return (n, m): products of sine waves of orders (m, 2) on a box at pixels (n, 2); 0 beyond the box.

    `box` : centre (x, y) and half-widths (x, y), px. A wave has unit norm over it.
    """

def most_probable(
    code: int,
    mirror: float,
    max_angle: float,
    mean: FloatArray,
    basis: FloatArray,
    directions: FloatArray,
    pixels: FloatArray,
    information: FloatArray,
    epoch: IntArray,
    precision: FloatArray,
    sigma: float,
    iterations: int,
    tolerance: float,
    start: FloatArray,
    moving: IntArray,
) -> tuple[FloatArray, float]:
    """Return the unknowns (p,) where Levenberg-Marquardt converges, and half the weighted squares or the loss there.

    Parameters
    ----------
    mean, basis : (17,), (17, 17): the lens is mean + basis · its unknowns; three more are each epoch's pose.
    directions, pixels, information, epoch : (n, 3), (n, 2), (n,), (n,) of the sightings.
    precision : (p,) of the prior, about 0.
    sigma : px, scale of Tukey's loss; 0 takes plain squares.
    iterations, tolerance : most steps, and the share of the cost below which a gain is the last.
    moving : the places of the unknowns that may change.

    Raises
    ------
    ValueError : lengths that differ, an epoch without a pose, no projection of this code.
    """

def residuals_of(
    code: int,
    mirror: float,
    max_angle: float,
    vector: FloatArray,
    directions: FloatArray,
    pixels: FloatArray,
    refraction_sd: FloatArray,
    air: FloatArray,
) -> FloatArray:
    """Return observed minus predicted pixels (n, 2), `robust_loss.UNSEEN_PX` where the lens shows nothing.

    Parameters
    ----------
    vector : (23,) the camera.
    refraction_sd, air : (n, k) rad, (k,): directions are raised by their product.
    """

def residuals_and_columns_of(
    code: int,
    mirror: float,
    max_angle: float,
    vectors: FloatArray,
    basis: FloatArray,
    directions: FloatArray,
    pixels: FloatArray,
    refraction_sd: FloatArray,
    epoch: IntArray,
    systematic_px: FloatArray,
    sizes: FloatArray,
    air: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return residuals (2, n) as of `residuals_of`, and derivatives of the prediction by the unknowns (2, size, n).

    Parameters
    ----------
    vectors : (epochs, 23) their cameras.
    basis : (17, 17) of the prior: what a unit of the lens's unknowns does to its parameters.
    systematic_px, sizes : (n, 2, s) px, (s,): pixels are displaced by their product.
    """

def paper_fit(
    code: int,
    mirror: float,
    max_angle: float,
    directions: FloatArray,
    pixels: FloatArray,
    information: FloatArray,
    orthogonality: FloatArray,
    circularity: float,
    edge_radius: float,
    edge_powers: FloatArray,
    cosine: FloatArray,
    sine: FloatArray,
    with_decentering: bool,
    monotony: float,
    ideal_slope: FloatArray,
    slope_by_radial: FloatArray,
    start: FloatArray,
    moving: IntArray,
    most_steps: int,
    least_gain: float,
    first_damping: float,
) -> tuple[FloatArray, float]:
    """Return the parameters (23,) that minimise Eq. 26, by Levenberg-Marquardt, and the sum of squares there.

    Penalties as of `calibration.paper.PenaltyArrays`, limits as of `calibration.paper.Limits`; `moving`: the places of
    the parameters that may change.
    """
