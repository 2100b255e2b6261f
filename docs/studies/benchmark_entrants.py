"""The peers in the benchmark: their camera models, fitted to the cases of a round with scipy's robust least squares.

    python docs/studies/benchmark_entrants.py ROUND/cases --out ENTRIES [--entrant NAME]…

No peer fits one camera to directions at infinity by itself: OpenCV's calibrations want boards, mrcal's optimizer boards
or points, OCamCalib boards. So what is entered is each one's own projection (`cv2.fisheye.projectPoints`,
`cv2.omnidir.projectPoints`, `mrcal.project`; Kannala and Brandt's and Scaramuzza's formulas are written out), fitted by
soft-L1 least squares to the directions that `sightings.csv` states, with the covariance that such a fit states. An
entrant whose library is not to be had is skipped with the reason; numpy and scipy are needed, nothing of sunarc.
"""

from __future__ import annotations

import argparse
import csv
import importlib
import json
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]
Model = Callable[[FloatArray, FloatArray], FloatArray]
"""Pixels (n, 2) of rays (n, 3) in the camera's frame, by the model's own numbers."""

_SOFT_PX = 1.0
_FEWEST = 30
_NEWTON_STEPS = 12
_STEPS = {True: 60, False: 20}
"""Of a fit, without slopes and with them."""
_SPLINED_TO = {"perspective": 1.3, "orthographic": 1.57}
"""Angle off the axis to which a spline is that of the data sheet."""
_SHAPES: dict[str, Callable[[FloatArray], FloatArray]] = {
    "equidistant": lambda angle: angle,
    "equisolid": lambda angle: 2.0 * np.sin(angle / 2.0),
    "stereographic": lambda angle: 2.0 * np.tan(np.minimum(angle, 3.0) / 2.0),
    "orthographic": lambda angle: np.where(angle < math.pi / 2.0, np.sin(np.minimum(angle, 1.57)), angle - 0.57),
    "perspective": lambda angle: np.tan(np.minimum(angle, 1.55)),
}


class Case(NamedTuple):
    """What an entrant is given of a case: image size, projection, and sightings with their apparent directions."""

    name: str
    size: tuple[int, int]
    projection: str
    directions: FloatArray
    pixels: FloatArray
    queries: FloatArray


class Fit(NamedTuple):
    """What was found: numbers of model and pose, and their covariance."""

    numbers: FloatArray
    covariance: FloatArray


class Prepared(NamedTuple):
    """A model for a case, the numbers that it starts at, the scale of each, and what holds each there, 1-sigma.

    slopes: the derivatives (n, 2, k) of its pixels by its numbers, where it has many.
    """

    model: Model
    start: FloatArray
    scale: FloatArray
    held: FloatArray | None = None
    slopes: Model | None = None


class Entrant(NamedTuple):
    """A peer: the module that it needs, and its model for a case and a focal length in px."""

    name: str
    needs: str
    prepared: Callable[[Case, float, Any], Prepared]


def read_case(folder: Path) -> Case:
    """Return a case."""
    facts = json.loads((folder / "case.json").read_text(encoding="utf-8"))
    with (folder / "sightings.csv").open(newline="", encoding="utf-8") as file:
        rows = [[float(row[k]) for k in _SEEN] for row in csv.DictReader(file)]
    with (folder / "queries.csv").open(newline="", encoding="utf-8") as file:
        asked = [[float(row["x_px"]), float(row["y_px"])] for row in csv.DictReader(file)]
    seen = np.array(rows).reshape(-1, 4)
    zenith, azimuth = np.radians(seen[:, 2]), np.radians(seen[:, 3])
    flat = np.sin(zenith)
    directions = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.cos(zenith)], axis=-1)
    size = (int(facts["width"]), int(facts["height"]))
    projection = facts["projection"] or "equidistant"
    return Case(folder.name, size, projection, directions, seen[:, :2], np.array(asked).reshape(-1, 2))


_SEEN = ("x_px", "y_px", "apparent_zenith_deg", "apparent_azimuth_deg")


def first_pose(case: Case) -> tuple[float, FloatArray]:
    """Return a focal length and a rotation vector: for each focal length the best rotation is known in closed form."""
    some = np.linspace(0, len(case.pixels) - 1, min(len(case.pixels), 300)).astype(int)
    offset = case.pixels[some] - (np.array(case.size) - 1.0) / 2.0
    radius, directions = np.linalg.norm(offset, axis=-1), case.directions[some]
    angles = np.linspace(0.0, {"perspective": 1.45, "orthographic": 1.57}.get(case.projection, 2.0), 800)
    shape = _SHAPES[case.projection](angles)
    best = (math.inf, 1.0, np.zeros(3))
    for focal in np.geomspace(0.15, 2.5, 90) * min(case.size):
        angle = np.interp(radius / focal, shape, angles)
        flat = np.sin(angle) / np.maximum(radius, 1e-9)
        rays = np.stack([offset[:, 0] * flat, offset[:, 1] * flat, np.cos(angle)], axis=-1)
        turn, _ = Rotation.align_vectors(rays, directions)
        # the median, and in angles: cloud and a wrong scale at the edge are not to decide
        cost = float(np.median(np.linalg.norm(turn.apply(directions) - rays, axis=-1)))
        if cost < best[0]:
            best = (cost, float(focal), turn.as_rotvec())
    return best[1], best[2]


def fitted(case: Case, ready: Prepared, turn: FloatArray) -> Fit:
    """Return the soft-L1 fit, and what it states of its errors."""

    def residuals(numbers: FloatArray) -> FloatArray:
        rays = Rotation.from_rotvec(numbers[:3]).apply(case.directions)
        off = np.nan_to_num(ready.model(numbers[3:], rays) - case.pixels, nan=1e3).ravel() / _SOFT_PX
        return off if ready.held is None else np.r_[off, (numbers[3:] - ready.start) / ready.held]

    def jacobian(numbers: FloatArray) -> FloatArray:
        ends = [residuals(numbers + sign * 1e-6 * axis) for axis in np.eye(3, numbers.size) for sign in (1.0, -1.0)]
        of_pose = np.stack([(more - less) / 2e-6 for more, less in zip(ends[::2], ends[1::2], strict=True)], axis=-1)
        rays = Rotation.from_rotvec(numbers[:3]).apply(case.directions)
        by_numbers = np.zeros((of_pose.shape[0], numbers.size - 3))
        if ready.slopes is not None and ready.held is not None:
            seen = np.nan_to_num(ready.slopes(numbers[3:], rays) / _SOFT_PX)
            by_numbers[:] = np.concatenate([seen.reshape(-1, numbers.size - 3), np.diag(1.0 / ready.held)])
        return np.concatenate([of_pose, by_numbers], axis=1)

    begin, steps = np.r_[turn, ready.start], np.r_[np.full(3, 0.05), ready.scale]
    by: Any = "2-point" if ready.slopes is None else jacobian
    found = least_squares(
        residuals, begin, jac=by, loss="soft_l1", x_scale=steps, max_nfev=_STEPS[ready.slopes is None]
    )
    off = residuals(found.x)[: 2 * len(case.pixels)].reshape(-1, 2)
    # of the middle of the residuals, as is usual with a robust loss; a pair has a Rayleigh median of 1.18
    variance = (float(np.median(np.linalg.norm(off, axis=-1))) / 1.1774) ** 2
    scaled = found.jac * steps
    normal = scaled.T @ scaled
    covariance = np.linalg.pinv(normal, rcond=1e-15, hermitian=True) * variance
    return Fit(found.x, steps[:, None] * covariance * steps)


def answers(case: Case, model: Model, fit: Fit) -> FloatArray:
    """Return zenith angles and azimuths of the queries, degrees, with 1-sigmas and correlation, (m, 5)."""
    turn = Rotation.from_rotvec(fit.numbers[:3])

    def pixels(numbers: FloatArray, directions: FloatArray) -> FloatArray:
        return model(numbers[3:], Rotation.from_rotvec(numbers[:3]).apply(directions))

    grid = lattice(3000)
    seen = pixels(fit.numbers, turn.inv().apply(grid))
    seen = np.where(np.all(np.isfinite(seen), axis=-1, keepdims=True), seen, 1e9)
    nearest = [int(np.argmin(np.sum((seen - query) ** 2, axis=-1))) for query in case.queries]
    found = turn.inv().apply(grid[nearest])
    for _ in range(_NEWTON_STEPS):
        sides = tangents(found)
        slope = slopes(lambda d: pixels(fit.numbers, d), found, sides)
        off = case.queries - pixels(fit.numbers, found)
        step = np.einsum("nab,nb->na", inverses(slope), off)
        size = np.maximum(np.linalg.norm(step, axis=-1, keepdims=True) / 0.05, 1.0)
        found = found + np.einsum("nka,na->nk", sides, step / size)
        found /= np.linalg.norm(found, axis=-1, keepdims=True)
    left = np.linalg.norm(case.queries - pixels(fit.numbers, found), axis=-1)
    inverse = inverses(slopes(lambda d: pixels(fit.numbers, d), found, tangents(found)))
    by_number = []
    for k, change in enumerate(1e-4 * np.sqrt(np.maximum(np.diag(fit.covariance), 1e-18))):
        ends = []
        for sign in (1.0, -1.0):
            numbers = fit.numbers.copy()
            numbers[k] += sign * change
            ends.append(pixels(numbers, found))
        by_number.append((ends[0] - ends[1]) / (2.0 * change))
    rows = inverse @ np.stack(by_number, axis=-1)
    covariance = np.degrees(1.0) ** 2 * rows @ fit.covariance @ np.swapaxes(rows, -1, -2)
    sigma = np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), 0.0))
    east, north, up = found.T
    columns = [
        np.degrees(np.arctan2(np.hypot(east, north), up)),
        np.degrees(np.arctan2(east, north)) % 360.0,
        sigma[:, 0],
        sigma[:, 1],
        covariance[:, 0, 1] / np.maximum(sigma[:, 0] * sigma[:, 1], 1e-300),
    ]
    return np.where((left < 0.1)[:, None], np.stack(columns, axis=-1), np.nan)


def lattice(count: int) -> FloatArray:
    """Return directions up to 115 degrees off the axis, (count, 3)."""
    z = 1.0 - (np.arange(count) + 0.5) / count * (1.0 - math.cos(math.radians(115.0)))
    about, flat = 2.399963 * np.arange(count), np.sqrt(1.0 - z**2)
    return np.stack([flat * np.cos(about), flat * np.sin(about), z], axis=-1)


def tangents(directions: FloatArray) -> FloatArray:
    """Return (n, 3, 2): unit vectors towards larger zenith angles, and towards larger azimuths."""
    east, north, up = directions.T
    flat = np.maximum(np.hypot(east, north), 1e-12)
    down = np.stack([up * east / flat, up * north / flat, -flat], axis=-1)
    return np.stack([down, np.stack([north / flat, -east / flat, 0.0 * flat], axis=-1)], axis=-1)


def slopes(pixels: Callable[[FloatArray], FloatArray], directions: FloatArray, sides: FloatArray) -> FloatArray:
    """Return (n, 2, 2): px a radian towards both sides."""
    ends = [[pixels(directions + sign * 1e-5 * sides[..., k]) for sign in (1.0, -1.0)] for k in (0, 1)]
    return np.asarray(np.stack([(more - less) / 2e-5 for more, less in ends], axis=-1))


def inverses(slope: FloatArray) -> FloatArray:
    """Return the inverses (n, 2, 2); NaN where there is none."""
    (a, b), (c, d) = np.moveaxis(slope, 0, -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.moveaxis(np.array([[d, -b], [-c, a]]), -1, 0) / (a * d - b * c)[:, None, None])


def polar(rays: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return angles off the axis, and cosine and sine of those about it."""
    x, y, z = rays.T
    across = np.hypot(x, y)
    safe = np.maximum(across, 1e-300)
    return np.arctan2(across, z), x / safe, y / safe


def middle(case: Case) -> list[float]:
    """Return the middle of the image."""
    return [(case.size[0] - 1.0) / 2.0, (case.size[1] - 1.0) / 2.0]


def soft_l1(case: Case, focal: float, _: object) -> Prepared:
    """Return the same model as sunarc's: an ideal projection, powers of the angle, decentering, square pixels."""
    shape = _SHAPES[case.projection]

    def model(n: FloatArray, rays: FloatArray) -> FloatArray:
        angle, cosine, sine = polar(rays)
        radius = shape(angle) + (angle[:, None] / (math.pi / 2.0)) ** np.arange(2, 6) @ n[5:9]
        x, y = radius * cosine, radius * sine
        return np.stack(
            [
                n[1] + n[0] * (x + n[3] * (radius**2 + 2.0 * x * x) + 2.0 * n[4] * x * y),
                n[2] + n[0] * (y + n[4] * (radius**2 + 2.0 * y * y) + 2.0 * n[3] * x * y),
            ],
            axis=-1,
        )

    return Prepared(
        model, np.array([focal, *middle(case), *[0.0] * 6]), np.array([5.0, 5.0, 5.0, *[1e-3] * 2, *[5e-3] * 4])
    )


def kannala_brandt(case: Case, focal: float, _: object) -> Prepared:
    """Return Kannala and Brandt's model: fx, fy, cx, cy, k1 to k4."""

    def model(n: FloatArray, rays: FloatArray) -> FloatArray:
        angle, cosine, sine = polar(rays)
        radius = angle * (1.0 + (angle[:, None] ** np.array([2, 4, 6, 8])) @ n[4:8])
        return np.stack([n[2] + n[0] * radius * cosine, n[3] + n[1] * radius * sine], axis=-1)

    return Prepared(model, np.array([focal, focal, *middle(case), *[0.0] * 4]), np.array([5.0] * 4 + [3e-3] * 4))


def cv_fisheye(case: Case, focal: float, cv2: Any) -> Prepared:  # noqa: ANN401 - a module
    """Return OpenCV's fisheye model, which divides by z: nothing at a right angle off the axis and beyond."""

    def model(n: FloatArray, rays: FloatArray) -> FloatArray:
        matrix = np.array([[n[0], 0.0, n[2]], [0.0, n[1], n[3]], [0.0, 0.0, 1.0]])
        safe = np.where(rays[:, 2:] > 1e-3, rays, [0.0, 0.0, 1.0])
        pixels, _ = cv2.fisheye.projectPoints(safe[:, None], np.zeros(3), np.zeros(3), matrix, n[4:8])
        return np.where(rays[:, 2:] > 1e-3, pixels[:, 0], np.nan)

    return kannala_brandt(case, focal, None)._replace(model=model)


def cv_omnidir(case: Case, focal: float, cv2: Any) -> Prepared:  # noqa: ANN401 - a module
    """Return OpenCV's omnidirectional model (Mei's): fx, fy, cx, cy, xi, k1, k2, p1, p2."""

    def model(n: FloatArray, rays: FloatArray) -> FloatArray:
        matrix = np.array([[n[0], 0.0, n[2]], [0.0, n[1], n[3]], [0.0, 0.0, 1.0]])
        points = np.ascontiguousarray(rays[:, None])
        pixels, _ = cv2.omnidir.projectPoints(points, np.zeros(3), np.zeros(3), matrix, float(n[4]), n[5:9])
        return np.asarray(pixels[:, 0], dtype=float)

    # xi 1 is a stereographic lens: its focal length is twice the slope on the axis
    start = np.array([2.0 * focal, 2.0 * focal, *middle(case), 1.0, *[0.0] * 4])
    return Prepared(model, start, np.array([10.0, 10.0, 5.0, 5.0, 0.1, 3e-2, 3e-2, 1e-3, 1e-3]))


def mrcal_opencv8(case: Case, focal: float, mrcal: Any) -> Prepared:  # noqa: ANN401
    """Return mrcal's LENSMODEL_OPENCV8."""

    def model(n: FloatArray, rays: FloatArray) -> FloatArray:
        return np.asarray(np.where(rays[:, 2:] > 1e-3, mrcal.project(rays, "LENSMODEL_OPENCV8", n), np.nan))

    return Prepared(model, np.array([focal, focal, *middle(case), *[0.0] * 8]), np.array([5.0] * 4 + [1e-2] * 8))


def mrcal_splined(case: Case, focal: float, mrcal: Any) -> Prepared:  # noqa: ANN401
    """Return mrcal's splined stereographic model with 6 by 6 knots, its core locked as mrcal advises.

    It starts as the lens of the data sheet, in which the pixels are linear in its numbers.
    """
    kind = "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=6_Ny=6_fov_x_deg=220"
    core = np.array([0.62 * focal, 0.62 * focal, *middle(case)])
    count = int(mrcal.lensmodel_num_params(kind)) - 4

    def model(n: FloatArray, rays: FloatArray) -> FloatArray:
        return np.asarray(mrcal.project(rays, kind, np.r_[core, n[:count]]))

    def slopes(n: FloatArray, rays: FloatArray) -> FloatArray:
        return np.asarray(mrcal.project(rays, kind, np.r_[core, n[:count]], get_gradients=True)[2][..., 4:])

    rays = lattice(3000)
    angle, cosine, sine = polar(rays)
    used = angle < _SPLINED_TO.get(case.projection, 1.9)
    radius = focal * _SHAPES[case.projection](angle[used])
    sheet = core[2:] + radius[:, None] * np.stack([cosine[used], sine[used]], axis=-1)
    missing = sheet - model(np.zeros(count), rays[used])
    weak = np.r_[slopes(np.zeros(count), rays[used]).reshape(-1, count), 1e-3 * core[0] * np.eye(count)]
    start = np.linalg.lstsq(weak, np.r_[missing.ravel(), np.zeros(count)], rcond=None)[0]
    # as in mrcal's own optimizer, knots that nothing is seen through are held, here to 20 px
    return Prepared(model, start, np.full(count, 0.01), np.full(count, 20.0 / core[0]), slopes)


def ocam(case: Case, focal: float, _: object) -> Prepared:
    """Return Scaramuzza's polynomial as OCamCalib inverts it: the radius by powers of the angle, an affine matrix."""

    def model(n: FloatArray, rays: FloatArray) -> FloatArray:
        angle, cosine, sine = polar(rays)
        along = (angle - math.pi / 4.0)[:, None] ** np.arange(6)
        radius = focal * (along @ n[:6])
        x, y = radius * cosine, radius * sine
        return np.stack([n[6] + x + n[8] * y, n[7] + n[9] * x + n[10] * y], axis=-1)

    powers = np.polynomial.Polynomial.fit(
        np.linspace(-0.75, 0.75, 60), _SHAPES[case.projection](np.linspace(-0.75, 0.75, 60) + math.pi / 4.0), 5
    ).convert()
    start = np.array([*powers.coef, *middle(case), 0.0, 0.0, 1.0])
    return Prepared(model, start, np.array([*[1e-2] * 6, 5.0, 5.0, *[1e-3] * 3]))


ENTRANTS = (
    Entrant("scipy-soft-l1", "", soft_l1),
    Entrant("kannala-brandt", "", kannala_brandt),
    Entrant("ocamcalib-polynomial", "", ocam),
    Entrant("opencv-fisheye", "cv2", cv_fisheye),
    Entrant("opencv-omnidir", "cv2.omnidir", cv_omnidir),
    Entrant("mrcal-opencv8", "mrcal", mrcal_opencv8),
    Entrant("mrcal-splined", "mrcal", mrcal_splined),
)
ABSENT = {
    "dlr-self-calibration": "works on its own folders of images of Mobotix cameras, not on sightings",
    "rms-astrometry": "works on its own images and platepars, not on sightings",
}


def library_of(entrant: Entrant) -> Any:  # noqa: ANN401 - a module, or the reason why there is none
    """Return the module that an entrant needs; None where it needs none.

    Raises
    ------
    ModuleNotFoundError
        Where it is not installed.
    """
    if not entrant.needs:
        return None
    name, _, part = entrant.needs.partition(".")
    module = importlib.import_module(name)
    if part and not hasattr(module, part):
        raise ModuleNotFoundError(name=f"{entrant.needs} (opencv-contrib-python)")
    return module


def entered(entrant: Entrant, library: Any, folders: list[Path], out: Path) -> None:  # noqa: ANN401 - a module
    """Write an entry."""
    out.mkdir(parents=True, exist_ok=True)
    stated = []
    for folder in folders:
        case, begin = read_case(folder), time.process_time()
        status = "answered" if len(case.pixels) >= _FEWEST else "refused"
        if status == "answered":
            focal, turn = first_pose(case)
            ready = entrant.prepared(case, focal, library)
            try:
                rows = answers(case, ready.model, fitted(case, ready, turn))
            except (ValueError, np.linalg.LinAlgError) as error:
                print(f"{entrant.name}: {case.name}: {error}")
                status = "failed"
            else:
                write(out / f"{case.name}.csv", np.column_stack([case.queries, rows]))
        stated.append([case.name, status, f"{time.process_time() - begin:.3f}"])
    with (out / "cases.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([["case", "status", "processor_s"], *stated])


def write(path: Path, rows: FloatArray) -> None:
    """Write a table of directions."""
    header = ["x_px", "y_px", "zenith_deg", "azimuth_deg", "sigma_zenith_deg", "sigma_azimuth_deg", "correlation"]
    with path.open("w", newline="", encoding="utf-8") as file:
        lines = [[f"{value:.9g}" if math.isfinite(value) else "" for value in row] for row in rows]
        csv.writer(file, lineterminator="\n").writerows([header, *lines])


def possible(names: list[str]) -> Iterator[tuple[Entrant, Any]]:
    """Yield the entrants that can run, with their library, and print why the others cannot."""
    for entrant in ENTRANTS:
        if names and entrant.name not in names:
            continue
        try:
            yield entrant, library_of(entrant)
        except ImportError as error:
            print(f"{entrant.name}: skipped: {error.name or error} is not installed")
    for name, reason in ABSENT.items():
        if not names or name in names:
            print(f"{name}: skipped: {reason}")


def main() -> None:
    """Enter them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--entrant", action="append", default=[], choices=[one.name for one in ENTRANTS])
    chosen = parser.parse_args()
    listed = json.loads((chosen.cases / "benchmark.json").read_text(encoding="utf-8"))["cases"]
    for entrant, library in possible(chosen.entrant):
        begin = time.process_time()
        entered(entrant, library, [chosen.cases / name for name in listed], chosen.out / entrant.name)
        print(f"{entrant.name}: {len(listed)} cases, {time.process_time() - begin:.1f} s of processor")


if __name__ == "__main__":
    main()
