"""How far published lenses are from their best simple projection, and the priors of the fit by them.

    python docs/studies/real_lenses.py

`real_lenses.csv` holds the numbers of published calibrations and lens curves, with their sources. A camera model is
projected onto a grid of directions and the camera of the fit (all but the translation, its priors too wide to count) is
fitted to that; a lens curve gives its radius alone. Printed for every lens, in px per 1,000 px from the axis to the
edge (90 degrees, or where the longer side ends): the best of the five projections; the residual radial distortion (RMS
over the angle, its share of a focal length taken out); the angle over which it changes (RMS over that of the slope);
p1 and p2 at the edge (RMS per axis) and the larger of p3 and p4; in units of 1e-4 the aspect ratio minus 1 and the
shear; the centre's offset in percent of the shorter side; and the RMS of what the camera of the fit cannot say. Then
the population: quantiles, and median and factor of 1 sigma of the scales that would give such values.

Kinds and their numbers: "ocam", a0 … a4, centre (row, column), c, d, e of Scaramuzza's toolbox; "kannala-brandt", fx,
fy, cx, cy, k1 … k4; "mei", xi, γ1, γ2, u0, v0, k1, k2, p1, p2; "prism", f, cx, cy, six radial, two tangential and four
prism coefficients of the angle; "powers", centre, aspect ratio, coefficients of the angle's powers; "curve", those
alone, of the radius over that at a right angle.

What such models do not show is a displacement field: they are smooth functions of few numbers.
"""

from __future__ import annotations

import argparse
import csv
import math
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.model.options import LensTolerances
from sunarc.calibration.solve.priors import LENS, lens_prior, radial_basis
from sunarc.optics.camera import POSE, RADIAL_ORDERS, Camera
from sunarc.optics.forward import distorted_radius, project_with_jacobian
from sunarc.optics.projections import PROJECTIONS, Projection, angle_limit, ideal_radius

FloatArray = NDArray[np.float64]
_RIGHT_ANGLE = math.pi / 2.0
_ROUNDS = 10
_ANGLES = np.linspace(0.0, 1.0, 91)
"""Where radii are compared, as shares of the angle at the edge."""
_WIDE = LensTolerances(aspect_px=20.0, skew_px=20.0, center_fraction=0.3, focal_length_fraction=1.0)
_WIDE_PX = 200.0
_SAID: dict[str, frozenset[str]] = {
    "ocam": frozenset({"aspect", "shear"}),
    "kannala-brandt": frozenset({"aspect"}),
    "mei": frozenset({"aspect", "decentering", "higher"}),
    "prism": frozenset({"decentering", "higher", "rest"}),
    "powers": frozenset({"aspect"}),
}
"""What a kind of model has numbers for, beside the radius and the centre."""
_FIXED = 0.01
"""Below this a number was not estimated."""


class Published(NamedTuple):
    """A row of the list; size (0, 0) where it is a curve."""

    name: str
    size: tuple[int, int]
    kind: str
    numbers: FloatArray


class Shape(NamedTuple):
    """What a lens is, px per 1,000 px of image radius; NaN what its model does not say."""

    edge_deg: float
    projection: Projection
    radial: float
    length_deg: float
    decentering: float
    higher: float
    aspect: float
    shear: float
    center: float
    rest: float


def published() -> list[Published]:
    """Return the list."""
    with Path(__file__).with_suffix(".csv").open(encoding="utf-8") as file:
        return [
            Published(
                row["name"],
                (int(row["width"] or 0), int(row["height"] or 0)),
                row["kind"],
                np.array(row["numbers"].split(), dtype=float),
            )
            for row in csv.DictReader(file, delimiter=";")
        ]


def _powers(angle: FloatArray, coefficients: FloatArray, step: int) -> FloatArray:
    """Return Σ c_i angle^(1 + i step)."""
    return sum((c * angle ** (1 + i * step) for i, c in enumerate(coefficients)), np.zeros_like(angle))


def pixels_of(lens: Published, angle: FloatArray, turn: FloatArray) -> FloatArray:
    """Return pixels (…, 2) at angles off the axis and about it, from x to y, of a published camera model."""
    n, c, s = lens.numbers, np.cos(turn), np.sin(turn)
    match lens.kind:
        case "ocam":
            radii = np.linspace(0.0, 1.2 * float(np.hypot(*lens.size)), 20000)
            angles = np.arctan2(radii, -np.polynomial.polynomial.polyval(radii, n[:5]))
            r = np.interp(angle, np.maximum.accumulate(angles), radii)
            return np.stack([r * c + n[9] * r * s + n[6], n[7] * r * s + n[8] * r * c + n[5]], axis=-1)
        case "kannala-brandt":
            r = _powers(angle, np.r_[1.0, n[4:]], 2)
            return np.stack([n[0] * r * c + n[2], n[1] * r * s + n[3]], axis=-1)
        case "mei":
            r = np.sin(angle) / (np.cos(angle) + n[0])
            x, y, k = _brown(r * c, r * s, n[7:9]), None, 1.0 + n[5] * r**2 + n[6] * r**4
            return np.stack([n[1] * (r * c * k + x[0]) + n[3], n[2] * (r * s * k + x[1]) + n[4]], axis=-1)
        case "prism":
            r = _powers(angle, np.r_[1.0, n[3:9]], 2)
            first, second = _brown(r * c, r * s, n[[10, 9]][::-1])
            x = r * c + first + n[11] * r**2 + n[12] * r**4
            y = r * s + second + n[13] * r**2 + n[14] * r**4
            return np.stack([n[0] * x + n[1], n[0] * y + n[2]], axis=-1)
        case _:
            r = _powers(angle, n[3:], 1)
            return np.stack([r * c + n[0], n[2] * r * s + n[1]], axis=-1)


def _brown(x: FloatArray, y: FloatArray, p: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the tangential distortion of OpenCV's p1, p2."""
    square = x**2 + y**2
    return (
        2.0 * p[0] * x * y + p[1] * (square + 2.0 * x**2),
        p[0] * (square + 2.0 * y**2) + 2.0 * p[1] * x * y,
    )


def residual_radius(radius: FloatArray, projection: Projection, edge: float) -> tuple[FloatArray, float]:
    """Return what is left of radii at `_ANGLES` but a focal length, and that."""
    ideal = ideal_radius(projection, _ANGLES * edge)
    focal = float(ideal @ radius / (ideal @ ideal))
    return radius - focal * ideal, focal


def best_projection(radius: FloatArray, edge: float) -> Projection:
    """Return the projection that radii at `_ANGLES` are nearest to."""
    possible = [one for one in PROJECTIONS if angle_limit(one) > edge + 1e-3 or one == "orthographic"]
    return min(possible, key=lambda one: float(np.sum(residual_radius(radius, one, edge)[0] ** 2)))


def radial_shape(radius: FloatArray, projection: Projection, edge: float) -> tuple[float, float]:
    """Return the residual distortion, px per 1,000 px, and the angle over which it changes, degrees."""
    left = residual_radius(radius, projection, edge)[0] * 1000.0 / radius[-1]
    rms = float(np.sqrt(np.mean(left**2)))
    return rms, math.degrees(rms / float(np.sqrt(np.mean(np.gradient(left, _ANGLES * edge) ** 2))))


def fitted(lens: Published, start: Camera, angle: FloatArray, turn: FloatArray) -> tuple[Camera, FloatArray]:
    """Return the camera nearest to a published model at some directions, and what it misses it by, px."""
    directions = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], axis=-1)
    wanted = pixels_of(lens, angle, turn)
    prior = lens_prior(start, tolerances=_WIDE, circle=None, field_angle=float(np.max(angle)))
    basis = np.zeros((23, LENS.size + 3))
    basis[LENS, : LENS.size], basis[POSE, LENS.size :] = prior.basis, np.eye(3)
    precision = np.ones(basis.shape[1])
    precision[5:15] = _WIDE_PX**-2.0  # radial distortion, p1 and p2 are in px
    unknowns, mean = np.zeros(basis.shape[1]), start.to_vector()
    unknowns[13] = 1e-3
    for _ in range(_ROUNDS):
        camera = start.replace_parameters(mean + basis @ unknowns)
        pixels, by_parameters, _ = project_with_jacobian(camera, directions)
        rows = (by_parameters @ basis).reshape(-1, unknowns.size) * 100.0
        right = np.r_[100.0 * (wanted - pixels).ravel(), -np.sqrt(precision) * unknowns]
        unknowns = unknowns + np.linalg.lstsq(np.vstack([rows, np.diag(np.sqrt(precision))]), right)[0]
    return camera, wanted - pixels


def shape_of_camera(lens: Published) -> Shape:
    """Return the shape of a published camera model."""
    width, height = lens.size
    center = pixels_of(lens, np.zeros(1), np.zeros(1))[0]
    angles, turns = np.linspace(0.01, _RIGHT_ANGLE, 400), np.linspace(0.0, 2.0 * math.pi, 48, endpoint=False)
    mean = np.linalg.norm(pixels_of(lens, angles[:, None], turns) - center, axis=-1).mean(axis=-1)
    edge = float(np.interp(0.5 * max(width, height), mean, angles))
    radius = np.interp(_ANGLES * edge, np.r_[0.0, angles], np.r_[0.0, mean])
    projection = best_projection(radius, edge)
    focal = residual_radius(radius, projection, edge)[1]
    start = Camera(
        width=width,
        height=height,
        projection=projection,
        focal_length_px=(focal, focal),
        principal_point_px=(float(center[0]), float(center[1])),
        rotation_cam_enu=(0.0, 0.0, 0.0),
    )
    angle, turn = (one.ravel() for one in np.meshgrid(np.linspace(0.02, edge, 60), turns))
    pixels = pixels_of(lens, angle, turn)
    shown = np.all((pixels >= 0.0) & (pixels <= np.array(lens.size) - 1.0), axis=-1)
    camera, missed = fitted(lens, start, angle[shown], turn[shown])
    fx, fy = camera.focal_length_px
    radius = 0.5 * (fx + fy) * distorted_radius(camera, _ANGLES * edge)
    per = 1000.0 / radius[-1]
    p = np.array(camera.decentering)
    at_edge = 3.0 * focal * float(ideal_radius(projection, edge)) ** 2 * per
    middle = (np.array(lens.size) - 1.0) / 2.0
    shape = Shape(
        math.degrees(edge),
        projection,
        *radial_shape(radius, projection, edge),
        at_edge * float(np.sqrt(np.mean(p[:2] ** 2))),
        float(np.max(np.abs(p[2:]))),
        1e4 * (fx / fy - 1.0),
        1e4 * camera.skew_px / fy,
        100.0 * float(np.linalg.norm(np.array(camera.principal_point_px) - middle)) / min(lens.size),
        per * float(np.sqrt(np.mean(missed**2))),
    )
    for name in ("decentering", "higher", "aspect", "shear", "rest"):
        if name not in _SAID[lens.kind] or abs(getattr(shape, name)) < _FIXED:
            shape = Shape._make(math.nan if field == name else value for field, value in shape._asdict().items())
    return shape


def shape_of(lens: Published) -> Shape:
    """Return the shape of a published lens."""
    if lens.kind != "curve":
        return shape_of_camera(lens)
    radius = 1000.0 * _powers(_ANGLES * _RIGHT_ANGLE, lens.numbers, 1)
    projection = best_projection(radius, _RIGHT_ANGLE)
    return Shape(90.0, projection, *radial_shape(radius, projection, _RIGHT_ANGLE), *[math.nan] * 6)


def scales_of(values: FloatArray, draws: FloatArray) -> tuple[int, float, float]:
    """Return how many values there are, and the median and factor of 1 sigma of the scales that would give them.

    Parameters
    ----------
    values : of lenses; NaN: not known.
    draws : of lenses of unit scale, whose scatter is not the scales'.
    """
    known, unit = np.log(np.abs(values[np.isfinite(values)])), np.log(np.abs(draws))
    spread = math.sqrt(max(float(np.var(known) - np.var(unit)), 0.0))
    return known.size, math.exp(float(np.mean(known) - np.mean(unit))), math.exp(spread)


def drawn_radial(rng: np.random.Generator, count: int) -> FloatArray:
    """Return `radial_shape` (count, 2) of lenses drawn from the fit's prior, of 1 px per 1,000 px."""
    focal = 1000.0 / float(ideal_radius("equidistant", _RIGHT_ANGLE))
    camera = Camera(
        width=2000,
        height=2000,
        projection="equidistant",
        focal_length_px=(focal, focal),
        principal_point_px=(999.5, 999.5),
        rotation_cam_enu=(0.0, 0.0, 0.0),
    )
    length = math.radians(LensTolerances().radial_length_deg)
    drawn = radial_basis(camera, length=length, upto=_RIGHT_ANGLE) @ rng.standard_normal((len(RADIAL_ORDERS), count))
    radii = [focal * distorted_radius(replace(camera, radial=tuple(one)), _ANGLES * _RIGHT_ANGLE) for one in drawn.T]
    return np.array([radial_shape(radius, "equidistant", _RIGHT_ANGLE) for radius in radii])


def main() -> None:
    """Print the tables."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    lenses = published()
    shapes = [shape_of(lens) for lens in lenses]
    print(f"{'':26s}{'edge':>5s} {'projection':14s}" + "".join(f"{name:>12s}" for name in Shape._fields[2:]))
    for lens, shape in zip(lenses, shapes, strict=True):
        print(f"{lens.name:26s}{shape[0]:5.0f} {shape[1]:14s}" + "".join(f"{value:12.2f}" for value in shape[2:]))
    rng = np.random.default_rng(1)
    columns = {name: np.array([getattr(shape, name) for shape in shapes], dtype=float) for name in Shape._fields[2:]}
    radial, normal = drawn_radial(rng, 1000), rng.standard_normal((1000, 2))
    draws = {"radial": radial[:, 0], "decentering": np.sqrt(np.mean(normal**2, axis=-1))}
    draws |= {"higher": np.abs(normal).max(axis=-1), "center": np.linalg.norm(normal, axis=-1)}
    for name in ("radial", "decentering", "higher", "aspect", "shear", "center"):
        count, median, factor = scales_of(columns[name], draws.get(name, normal[:, 0]))
        low, middle, high = np.nanquantile(np.abs(columns[name]), [0.16, 0.5, 0.84])
        print(f"{name:12s}{count:3d}: {middle:6.2f} ({low:.2f} to {high:.2f}); scale {median:.2f}, factor {factor:.2f}")
    lengths = columns["length_deg"][[shape.edge_deg > 80.0 for shape in shapes]]
    print("length_deg, quartiles", np.quantile(lengths, [0.25, 0.5, 0.75]).round(1), end=" ")
    print("of the prior's draws", np.quantile(radial[:, 1], [0.25, 0.5, 0.75]).round(1))


if __name__ == "__main__":
    main()
