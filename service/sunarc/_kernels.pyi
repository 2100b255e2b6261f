"""The compiled loops (service/kernels): arrays in C order and of exactly these types; anything else is a TypeError.

They run without the interpreter's lock and start no threads. Results are new arrays.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from sunarc.common.array_types import FloatArray, Image, IntArray

Float32Array: TypeAlias = NDArray[np.float32]

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

def evidence_terms(
    matrices: FloatArray,
    vectors: FloatArray,
    at: FloatArray,
    precision: FloatArray,
    order: IntArray,
    pairs: FloatArray,
) -> FloatArray:
    """Return (n, k): v' M⁻¹ v - log |M| of normal equations (n, p, p), (n, p) about unknowns `at` (p,).

    Parameters
    ----------
    precision : (p,) prior precisions, of all but the last ten in the order.
    order : (p,) places; the last ten are eight radial coefficients, p1 and p2.
    pairs : (k, 2) precisions of the eight and of the two, which M has with the others', and v with them times `at`.

    Raises
    ------
    ValueError : lengths that differ, a place beyond the unknowns.
    """

def moments_of(
    covariances: FloatArray,
    field: IntArray,
    left: FloatArray,
    right: FloatArray,
    beside: FloatArray,
    shift: FloatArray,
) -> FloatArray:
    """Return second moments (k, 3, n), xx, xy and yy: L' C R made symmetric of covariances (k, q, q), and more.

    Parameters
    ----------
    field : (k,) which of the f L and R each covariance has.
    left, right : L and R (f, 2, q, n).
    beside : (f, 3, n) moments that are added. shift : (2, k, n) whose products are.

    Raises
    ------
    ValueError : lengths that differ, a field that is none.
    """

def moments_below(
    moments: FloatArray,
    share: FloatArray,
    stated: FloatArray,
    cosines: FloatArray,
    bounds: FloatArray,
    smallest: float,
) -> FloatArray:
    """Return (n, m): the parts of a mean variance that its smallest values make up, which have m shares of all.

    With l₁, l₂ the eigenvalues of stated⁻¹ · moments the values are their mean plus half their difference times the
    cosines, of each of k Gaussians.

    Parameters
    ----------
    moments, share : (k, 3, n) xx, xy and yy of the Gaussians; (k,) of them.
    stated : (3, n) of the covariance in whose units they are.
    bounds : (m,) shares, ascending.
    smallest : value that smaller ones are taken for.

    Raises
    ------
    ValueError : lengths that differ.
    """

def compute_residuals(
    code: int,
    mirror: float,
    max_angle: float,
    vector: FloatArray,
    directions: FloatArray,
    pixels: FloatArray,
) -> FloatArray:
    """Return observed minus predicted pixels (n, 2), `robust_statistics.UNSEEN_PX` where the lens shows nothing.

    Parameters
    ----------
    vector : (23,) the camera.
    """

def residuals_and_jacobian(
    code: int,
    mirror: float,
    max_angle: float,
    vectors: FloatArray,
    basis: FloatArray,
    directions: FloatArray,
    pixels: FloatArray,
    epoch: IntArray,
    systematic_px: FloatArray,
    sizes: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return residuals (2, n) of `compute_residuals`, and derivatives of the prediction by the unknowns (2, size, n).

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
    edge: FloatArray,
    with_decentering: bool,
    ideal_slope: FloatArray,
    slope_by_radial: FloatArray,
    start: FloatArray,
    moving: IntArray,
    most_steps: int,
    least_gain: float,
    first_damping: float,
) -> tuple[FloatArray, float, FloatArray]:
    """Return the parameters (23,) that minimise Eq. 26, half the squares there, and J'J (23, 23).

    Parameters
    ----------
    orthogonality, circularity, edge, with_decentering, ideal_slope, slope_by_radial : `calibration.paper.Penalties`.
    moving : the places of the parameters that may change.
    most_steps, least_gain : most steps, and the share of the squares below which a gain is the last.
    """

def render_disc(
    rows: int,
    columns: int,
    x: float,
    y: float,
    psf: float,
    stretch: FloatArray,
    positions: FloatArray,
    weights: FloatArray,
) -> FloatArray:
    """Return the (11, rows, columns) planes of `detection.disc.model.render_disc`.

    `positions`, `weights` : (k, 2), (k,) of `Sources`.
    """

def likelihood_of(
    planes: FloatArray,
    moved: NDArray[np.intp],
    scale: FloatArray,
    glare: FloatArray,
    places: NDArray[np.intp],
    counts: FloatArray,
    colour: NDArray[np.intp],
    offset: FloatArray,
    flux: FloatArray,
    background: FloatArray,
    around: FloatArray,
    noise: float,
    gain: float,
    binning: int,
    clip: float,
    by_counts: bool,
) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """Compare a disc's model with the pixels.

    Parameters
    ----------
    planes : (k, binning rows, binning columns) the disc of unit flux, first its value, on the sensor's pixels.
    moved, scale : the planes that are derivatives by the free nonlinear parameters, and what each is multiplied by.
    glare : u and v are (a dx - b dy, c dy - b dx) and dx, dy are what a pixel is off (x, y): a, b, c, x, y.
    places, counts, colour, offset : see `detection.disc.model.UsedPixels`.
    flux, background : one per colour.
    around : the background's slope in x and y, smear of the columns, glare.
    noise, gain : of the readout, counts; electrons per count.
    binning, clip : each pixel is the mean of binning² of the sensor's, which are clipped at so many counts.
    by_counts : the variance follows from the counts, not from the model.

    Returns
    -------
    Twice the negative log likelihood, residual (n,), weight (n,) and Jacobian (n, p), its columns the free nonlinear
    parameters, flux and background of each colour, slope in x and y, smear and glare.

    Raises
    ------
    ValueError : lengths that differ, a plane, a place or a colour that is not there.
    """

def merge_exposures(
    stack: Image,
    exposures: FloatArray,
    black: float,
    full_scale: float,
    read_variance: float,
    counts_per_electron: float,
) -> tuple[NDArray[np.uint16], int]:
    """Merge (frames, rows, columns), shortest first, and count what is saturated in the first.

    Each is weighted by its noise, of which the photons' is that of the pooled rate.
    """

def most_followed(points: FloatArray, circles: FloatArray, scale: float) -> int:
    """Return which circle (m, 3) has the largest sum of the weights of points (n, 2), the first of equals.

    The weights are Tukey's, harder outside of the circle than inside; a circle of NaN has none.
    """

def fitted_rim(
    points: FloatArray,
    start: FloatArray,
    scale: float,
    drawn_out: float,
    least_points: int,
    least_scale_px: float,
    least_scale: float,
) -> tuple[FloatArray, float, FloatArray] | None:
    """Fit a circle whose radius varies with twice the angle, by Gauss and Newton with the weights of `most_followed`.

    Parameters
    ----------
    points : (n, 2), px.
    start : (3,) x, y, radius, px.
    scale : scatter of the points about that, px.
    drawn_out : 1-sigma of the variation over the radius, about 0.
    least_points : points with a weight below which there is no circle.
    least_scale_px, least_scale : of the scatter, px and of the radius.

    Returns
    -------
    State (x, y, radius, cosine and sine of the variation), scatter in px, and the residuals (n,) before the last step;
    None where there is no circle, or a number is none.
    """

def crossings(light: FloatArray, level: float, lasting: int, radii: FloatArray) -> FloatArray:
    """Return the radius on each ray, (rays,), from which the light stays below a level for some samples.

    NaN where the light does not fall, a ray begins below the level, or is not known before it falls.

    Parameters
    ----------
    light : (rays, radii), NaN where it is not known.
    lasting : samples.
    radii : of the samples, px, equidistant; two at least.
    """

def cloud_transmittance(
    layer: Float32Array, offset_x: float, offset_y: float, directions: Float32Array
) -> Float32Array:
    """Return the transmittance (n,) of a `CloudLayer` in directions (n, 3), 1 below the horizon."""

def sky_light(
    field: Float32Array,
    sun: Float32Array,
    levels: Float32Array,
    layer: Float32Array,
    offset_x: float,
    offset_y: float,
) -> Float32Array:
    """Return the light (h, w) of sky, clouds, ground and the lens's glare, in the units of `levels`.

    Parameters
    ----------
    field : (h, w, 4) from `simulation.scene_parts.pixel_field`.
    sun : (3,) its direction.
    levels : clear zenith, cloud, ground, glare (strength, core), forward scattering in cloud.
    layer, offset_x, offset_y : the clouds; a layer of size 1 is a clear sky.
    """

def night_glow(
    field: Float32Array,
    levels: Float32Array,
    city: Float32Array,
    moon: Float32Array,
    layer: Float32Array,
    offset_x: float,
    offset_y: float,
) -> Float32Array:
    """Return the diffuse light (h, w) of the night.

    Parameters
    ----------
    levels : the dark zenith, the town's dome on the horizon, the moonlit sky far from the moon, the lens's glare one
        degree from the moon; in light.
    city, moon : (2,) east and north of the town, (3,) direction of the moon; the rest as of `sky_light`.
    """

def count_light(
    light: Float32Array, smear: Float32Array, noise: Float32Array, starts: IntArray, sensor: Float32Array
) -> NDArray[np.uint16]:
    """Return the counts (h, w) of an exposure.

    Parameters
    ----------
    smear : (w,) electrons that every row of a column gets besides.
    noise, starts : (n,) unit normal numbers; (h,) where each row begins in them.
    sensor : electrons per light, most electrons, read noise squared (or less than 0: no noise at all), counts per
        electron, black level, full scale.
    """

def image_of_points(rows: int, columns: int, points: FloatArray) -> Float32Array:
    """Return Gaussian images, integrated over each pixel, of points (n, 4): column, row, light in all, sigma, px."""

def point_spread_equations(
    x: FloatArray, y: FloatArray, value: FloatArray, weight: FloatArray, at: FloatArray, free: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return chi² (n,), normal matrices (n, k, k) and gradients (n, k) of Gaussians and constants on pixels (n, m).

    Parameters
    ----------
    x, y : of the pixels, px. value : counts. weight : 1 over the variance.
    at : (n, 7) x, y, height, level, and xx, xy, yy of the inverse covariance.
    free : k, how many of these are unknown: 0, 4 or 7.
    """

def votes_of_pairs(keys: IntArray, first: IntArray, last: IntArray, place: IntArray, tilts: int, bins: int) -> IntArray:
    """Return the votes (tilts, bins) of pairs of stars and detections, of three neighbouring bins together.

    Parameters
    ----------
    keys : 2 * bins * tilt + bin of the vote of a star for a detection in bin 0.
    first, last, place : (n,) of each detection: the keys that it takes, and its bin, which moves them.
    """
