"""The border between Python and the compiled module: a wrong call is an exception, an odd one a right answer."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr
from tests.fixtures.calibration import observed, small_camera, small_problem, spread_directions

from sunarc import _kernels
from sunarc.calibration.model.options import PaperOptions
from sunarc.calibration.paper import make_penalties
from sunarc.optics.forward import kernel_optics, project
from sunarc.optics.inverse import unproject
from sunarc.optics.inverse_table import inverse_table

N = 70  # more than a block
CAMERA = small_camera("equisolid")
OPTICS = kernel_optics(CAMERA)._asdict()
SKY = spread_directions(N, widest_deg=60.0)
PIXELS = project(CAMERA, SKY)
ROTATION = np.eye(3)
TABLE = inverse_table(CAMERA)
CONSTANTS = np.array(TABLE.constants)
PROBLEM = small_problem(CAMERA, n_epochs=2)
SEEN = observed(CAMERA, SKY, sigma_px=0.1)
BOX, COEFFICIENTS = np.array([320.0, 240.0, 500.0, 400.0]), np.full((2, 3, 4), 0.1)
EPOCH = np.repeat([0, 1], N // 2)
SHEETS = np.ones((12, 15, 3))
_FIT = OPTICS | {"directions": SKY, "pixels": PIXELS}

_STAMPS = np.random.default_rng(3).uniform(0.1, 2.0, (N, 9, 4))
"""x, y, value and weight of the pixels about each star."""

CALLS: dict[str, dict[str, Any]] = {
    "rotation_and_jacobian": {"vector": np.array([0.1, 0.2, 0.3])},
    "pixels_of": OPTICS | {"vector": CAMERA.to_vector(), "rotation": ROTATION, "directions": SKY},
    "pixels_and_rows_of": OPTICS
    | {"vector": CAMERA.to_vector(), "rotation": ROTATION, "jacobian": ROTATION, "directions": SKY},
    "directions_of": {
        "code": OPTICS["code"],
        "mirror": -1.0,
        "limit": 1.4,
        "plane": np.array([200.0, 200.0, 0.0, 320.0, 240.0]),
        "radial": np.zeros(8),
        "decentering": np.array([1e-3, 0.0, 0.0, 0.0]),
        "rotation": ROTATION,
        "pixels": PIXELS,
    },
    "directions_from_table": {
        "constants": CONSTANTS,
        "rotation": ROTATION,
        "table": TABLE.pieces,
        "rounds": 3,
        "pixels": PIXELS,
    },
    "pixels_from_grid": {
        "grid": np.ones((9, 8, 2)),
        "origin": np.full(2, -200.0),
        "step": np.array([150.0, 120.0]),
        "pixels": PIXELS,
    },
    "back_projected": {
        "rotation": ROTATION,
        "sheet": SHEETS[..., 0].copy(),
        "slope": np.ones(12),
        "rings_per_radian": 5.0,
        "width": 640,
        "height": 480,
        "pixels": PIXELS,
        "directions": SKY,
    },
    "projected": {
        "rotation": ROTATION,
        "sheets": SHEETS,
        "rings_per_radian": 5.0,
        "width": 640,
        "height": 480,
        "pixels": PIXELS,
        "directions": SKY,
    },
    "polar_values": {
        "constants": CONSTANTS,
        "sheets": SHEETS[..., :2].copy(),
        "rings_per_radius": 5.0,
        "pixels": PIXELS,
    },
    "displacement_at": {"box": BOX, "coefficients": COEFFICIENTS, "pixels": PIXELS},
    "displacement_and_slopes": {"box": BOX, "coefficients": COEFFICIENTS, "pixels": PIXELS},
    "displacement_inverse": {"box": BOX, "coefficients": COEFFICIENTS, "pixels": PIXELS},
    "waves_at": {"pixels": PIXELS, "box": BOX, "orders": np.array([[1, 2], [3, 1]])},
    "most_probable": _FIT
    | {
        "mean": np.ascontiguousarray(PROBLEM.prior.mean),
        "basis": np.ascontiguousarray(PROBLEM.prior.basis),
        "information": np.ones(N),
        "epoch": EPOCH,
        "precision": np.ones(PROBLEM.size),
        "sigma": 1.0,
        "iterations": 2,
        "tolerance": 1e-6,
        "start": PROBLEM.unknowns([CAMERA, CAMERA]),
        "moving": np.arange(PROBLEM.size),
    },
    "compute_residuals": _FIT | {"vector": CAMERA.to_vector()},
    "residuals_and_jacobian": _FIT
    | {
        "vectors": np.stack([CAMERA.to_vector()] * 2),
        "basis": np.ascontiguousarray(PROBLEM.prior.basis),
        "epoch": EPOCH,
        "systematic_px": np.full((N, 2, 3), 0.1),
        "sizes": np.ones(3),
    },
    "evidence_terms": {
        "matrices": np.stack([np.diag(np.arange(1.0, 14.0))] * 2),
        "vectors": np.ones((2, 13)),
        "at": np.ones(13),
        "precision": np.ones(13),
        "order": np.arange(13)[::-1].copy(),
        "pairs": np.ones((4, 2)),
    },
    "moments_of": {
        "covariances": np.stack([np.eye(3)] * 2),
        "field": np.array([1, 0]),
        "left": np.ones((2, 2, 3, 5)),
        "right": np.ones((2, 2, 3, 5)),
        "beside": np.ones((2, 3, 5)),
        "shift": np.ones((2, 2, 5)),
    },
    "moments_below": {
        "moments": np.ones((4, 3, 5)),
        "share": np.full(4, 0.25),
        "stated": np.array([[2.0], [0.5], [1.0]]) * np.ones(5),
        "cosines": np.array([-0.5, 0.5]),
        "bounds": np.array([0.0, 0.4, 1.0]),
        "smallest": 1e-6,
    },
    "paper_fit": _FIT
    | make_penalties(CAMERA.projection, PaperOptions())._asdict()
    | {
        "information": np.ones(N),
        "start": CAMERA.at_every_angle().to_vector(),
        "moving": np.arange(20),
        "most_steps": 2,
        "least_gain": 1e-6,
        "first_damping": 1e-3,
    },
}
_GREY = np.random.default_rng(5).uniform(0.0, 1.0, (6, 8, 4)).astype(np.float32)
_AROUND = np.arange(N) * (2.0 * np.pi / N)
_CLOUDS = {"layer": np.full((4, 4), 0.5, np.float32), "offset_x": 40.0, "offset_y": 80.0}
_MERGE = {
    "stack": np.arange(48, dtype=np.uint16).reshape(2, 4, 6) * 90,
    "exposures": np.array([10.0, 40.0]),
    "black": 32.0,
    "full_scale": 4095.0,
    "read_variance": 6.0,
    "counts_per_electron": 0.2,
}
CALLS |= {
    "render_disc": {
        "rows": 12,
        "columns": 14,
        "x": 6.2,
        "y": 5.7,
        "psf": 0.7,
        "stretch": np.array([[2.9, 0.2], [0.2, 2.5]]),
        "positions": np.array([[0.0, 0.0], [0.5, -0.2], [-0.5, 0.2]]),
        "weights": np.array([0.5, 0.2, 0.3]),
    },
    "likelihood_of": {
        "planes": np.random.default_rng(6).uniform(0.1, 1.0, (4, 16, 20)),
        "moved": np.array([1, 3]),
        "scale": np.array([1.0, 0.7]),
        "glare": np.array([0.4, 0.1, 0.5, 2.2, 1.8]),
        "places": np.arange(N),
        "counts": np.linspace(50.0, 900.0, N),
        "colour": np.arange(N) % 3,
        "offset": np.random.default_rng(7).uniform(-5.0, 5.0, (N, 2)),
        "flux": np.array([500.0, 600.0, 700.0]),
        "background": np.array([20.0, 25.0, 30.0]),
        "around": np.array([0.5, -0.25, 0.01, 4.0]),
        "noise": 2.0,
        "gain": 5.0,
        "binning": 2,
        "clip": 400.0,
        "by_counts": False,
    },
    "merge_exposures": _MERGE,
    "most_followed": {
        "points": PIXELS,
        "circles": np.array([[300.0, 200.0, 90.0], [320.0, 240.0, 100.0]]),
        "scale": 10.0,
    },
    "fitted_rim": {
        "points": np.array([320.0, 240.0]) + 12.0 * np.column_stack([np.cos(_AROUND), np.sin(_AROUND)]),
        "start": np.array([321.0, 239.0, 11.0]),
        "scale": 1.0,
        "drawn_out": 0.1,
        "least_points": 10,
        "least_scale_px": 0.3,
        "least_scale": 0.01,
    },
    "crossings": {
        "light": np.tile(np.linspace(1.0, 0.5, 12), (N, 1)),
        "level": 0.9,
        "lasting": 3,
        "radii": np.arange(5.0, 17.0),
    },
    "cloud_transmittance": _CLOUDS | {"directions": SKY.astype(np.float32)},
    "sky_light": _CLOUDS
    | {"field": _GREY, "sun": np.array([0.0, 0.6, 0.8], np.float32), "levels": np.full(6, 0.1, np.float32)},
    "night_glow": _CLOUDS
    | {
        "field": _GREY,
        "levels": np.full(4, 0.1, np.float32),
        "city": np.array([0.6, 0.8], np.float32),
        "moon": np.array([0.0, 0.6, 0.8], np.float32),
    },
    "count_light": {
        "light": _GREY[..., 0].copy(),
        "smear": np.zeros(8, np.float32),
        "noise": np.linspace(-2.0, 2.0, 50, dtype=np.float32),
        "starts": np.arange(37, 43),
        "sensor": np.array([100.0, 23_000.0, 144.0, 0.2, 32.0, 4095.0], np.float32),
    },
    "image_of_points": {"rows": 7, "columns": 9, "points": np.array([[3.1, 2.9, 5.0, 0.8], [8.0, 0.0, 1.0, 1.4]])},
    "point_spread_equations": {
        **{name: _STAMPS[..., column].copy() for column, name in enumerate(("x", "y", "value", "weight"))},
        "at": np.tile([0.1, -0.2, 3.0, 0.5, 0.7, 0.1, 0.6], (N, 1)),
        "free": 7,
    },
    "votes_of_pairs": {
        "keys": np.array([3, 8, 11, 19]),
        "first": np.array([0, 1]),
        "last": np.array([3, 4]),
        "place": np.array([2, 5]),
        "tilts": 2,
        "bins": 6,
    },
}
# kernels whose results for no pixels, directions or sightings are empty
_WHOLE = {"rotation_and_jacobian", "most_probable", "paper_fit", "render_disc", "merge_exposures"}
_WHOLE |= {
    "evidence_terms",
    "moments_of",
    "moments_below",
    "most_followed",
    "fitted_rim",
    "sky_light",
    "night_glow",
    "count_light",
    "image_of_points",
    "votes_of_pairs",
}
PER_PLACE = [name for name in CALLS if name not in _WHOLE]
Spoiled = Callable[[np.ndarray], np.ndarray | None]


def wrong_type(array: np.ndarray) -> np.ndarray:
    return array.astype({np.dtype(np.int64): np.int32, np.dtype(np.float32): np.float64}.get(array.dtype, np.float32))


def backwards(array: np.ndarray) -> np.ndarray | None:
    return array[::-1] if array.shape[0] > 1 else None


def in_steps(array: np.ndarray) -> np.ndarray | None:
    return np.repeat(array, 2, axis=0)[::2] if array.shape[0] > 1 else None


def by_columns(array: np.ndarray) -> np.ndarray | None:
    return np.asfortranarray(array) if array.ndim > 1 and min(array.shape) > 1 else None


def one_axis_more(array: np.ndarray) -> np.ndarray:
    return array[..., None]


def one_column_more(array: np.ndarray) -> np.ndarray | None:
    return np.concatenate([array, array[..., :1]], axis=-1) if array.ndim > 1 else None


def call(name: str, **given: object) -> Any:  # noqa: ANN401 - arrays, or tuples with them
    return getattr(_kernels, name)(**{**CALLS[name], **given})


def flat(answer: Any) -> list[np.ndarray]:  # noqa: ANN401 - as of `call`
    return [np.asarray(part) for part in (answer if isinstance(answer, tuple) else (answer,))]


def test_every_kernel_is_called_here() -> None:
    names = {name for name in dir(_kernels) if not name.startswith("_")}
    assert set(CALLS) <= names
    for name in CALLS:
        assert all(np.isfinite(part).all() for part in flat(call(name)) if part.dtype == np.float64)


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("spoil", [wrong_type, backwards, in_steps, by_columns, one_axis_more])
def test_an_array_of_another_type_order_or_depth_is_refused(name: str, spoil: Spoiled) -> None:
    for argument, array in CALLS[name].items():
        if isinstance(array, np.ndarray) and (spoiled := spoil(array)) is not None:
            with pytest.raises(TypeError):
                call(name, **{argument: spoiled})


@pytest.mark.parametrize("name", CALLS)
def test_arrays_whose_lengths_do_not_go_together_are_refused_or_answered(name: str) -> None:
    for argument, array in CALLS[name].items():
        if not isinstance(array, np.ndarray):
            continue
        for other in (array[:-1].copy(), np.concatenate([array, array[:1]]), array[:0].copy(), one_column_more(array)):
            if other is not None:
                try:
                    call(name, **{argument: other})
                except (TypeError, ValueError):
                    continue


@pytest.mark.parametrize("name", CALLS)
def test_lists_none_and_numbers_are_no_arrays(name: str) -> None:
    for argument, array in CALLS[name].items():
        if isinstance(array, np.ndarray):
            for other in (array.tolist(), None, 1.0, "abc"):
                with pytest.raises(TypeError):
                    call(name, **{argument: other})


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_numbers_that_are_none_end_in_an_answer(name: str, value: float) -> None:
    for argument, array in CALLS[name].items():
        if isinstance(array, np.ndarray) and array.dtype in {np.dtype(np.float64), np.dtype(np.float32)}:
            worst = min(value, float(np.finfo(array.dtype).max)) if np.isfinite(value) else value
            spoiled = array.copy()
            spoiled.flat[array.size // 2] = worst
            assert flat(call(name, **{argument: spoiled}))
            assert flat(call(name, **{argument: np.full_like(array, worst)}))


_BY_PLACE = [
    "most_probable",
    "residuals_and_jacobian",
    "paper_fit",
    "waves_at",
    "likelihood_of",
    "count_light",
    "evidence_terms",
    "moments_of",
    "votes_of_pairs",
]


@pytest.mark.parametrize("name", _BY_PLACE)
def test_places_out_of_bounds_are_refused(name: str) -> None:
    for argument, array in CALLS[name].items():
        if isinstance(array, np.ndarray) and array.dtype == np.int64:
            for value in (-1, 2**40, np.iinfo(np.int64).min):
                spoiled = array.copy()
                spoiled.flat[-1] = value
                with pytest.raises(ValueError, match=r".+"):
                    call(name, **{argument: spoiled})


@pytest.mark.parametrize("name", PER_PLACE)
def test_no_pixel_and_no_direction_have_an_empty_answer(name: str) -> None:
    none = {
        argument: array[:0].copy()
        for argument, array in CALLS[name].items()
        if isinstance(array, np.ndarray) and array.shape[0] == N
    }
    assert none
    assert all(part.size == 0 for part in flat(call(name, **none)) if part.ndim)


@pytest.mark.parametrize("name", CALLS)
def test_read_only_arrays_are_read_and_none_is_written(name: str) -> None:
    frozen, before = {}, {}
    for argument, array in CALLS[name].items():
        if isinstance(array, np.ndarray):
            before[argument] = array.copy()
            frozen[argument] = array.copy()
            frozen[argument].flags.writeable = False
    for one, other in zip(flat(call(name, **frozen)), flat(call(name)), strict=True):
        np.testing.assert_array_equal(one, other)
    for argument, array in before.items():
        np.testing.assert_array_equal(CALLS[name][argument], array)


def test_sightings_that_another_thread_changes_end_in_an_answer() -> None:
    epoch = np.tile(EPOCH, 300)
    many = {name: np.tile(CALLS["most_probable"][name], (300, 1)) for name in ("directions", "pixels")}
    ended = threading.Event()

    def spoil() -> None:
        while not ended.wait(0.0):
            epoch[:] = 2**40
            epoch[:] = 0

    other = threading.Thread(target=spoil)
    other.start()
    try:
        for _ in range(20):
            try:
                found, _ = call("most_probable", **many, epoch=epoch, information=np.ones(epoch.size))
                assert found.shape == (PROBLEM.size,)
            except ValueError:
                continue
    finally:
        ended.set()
        other.join()


def test_more_places_than_one_batch_are_answered_as_one_by_one() -> None:
    pixels = np.tile(PIXELS, (20, 1))
    together = unproject(CAMERA, pixels)
    np.testing.assert_array_equal(together, np.tile(together[:N], (20, 1)))


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("render_disc", {"rows": 1 << 17}),
        ("render_disc", {"weights": np.ones(2)}),
        ("likelihood_of", {"binning": 0}),
        ("likelihood_of", {"binning": 3}),
        ("likelihood_of", {"counts": np.ones(N - 1)}),
        ("merge_exposures", {"exposures": np.ones(3)}),
        ("merge_exposures", {"stack": np.zeros((0, 4, 6), np.uint16), "exposures": np.ones(0)}),
        ("sky_light", {"layer": np.ones((3, 3), np.float32)}),
        ("night_glow", {"layer": np.ones((4, 2), np.float32)}),
        ("cloud_transmittance", {"layer": np.ones((0, 0), np.float32)}),
        ("count_light", {"noise": np.zeros(7, np.float32)}),
        ("count_light", {"starts": np.arange(38, 44)}),
        ("image_of_points", {"columns": 1 << 17}),
    ],
)
def test_images_that_do_not_go_together_are_refused(name: str, given: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r".+"):
        call(name, **given)


def test_an_image_without_pixels_is_empty() -> None:
    for rows, columns in ((0, 14), (12, 0), (0, 0)):
        assert call("render_disc", rows=rows, columns=columns).shape == (11, rows, columns)
        assert call("image_of_points", rows=rows, columns=columns).shape == (rows, columns)
        assert call("merge_exposures", stack=np.zeros((2, rows, columns), np.uint8))[0].shape == (rows, columns)
        assert call("sky_light", field=np.zeros((rows, columns, 4), np.float32)).shape == (rows, columns)


def test_a_disc_where_there_is_none_is_not_a_number() -> None:
    assert np.isnan(call("render_disc", x=np.nan)).any()
    assert not call("render_disc", x=np.inf).any()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("n", [1, 255, 256, 700])
def test_a_merge_is_the_weighted_mean_of_what_is_not_saturated(dtype: type, n: int) -> None:
    full, black, read_variance, per_electron = float(np.iinfo(dtype).max) * 0.9, 8.0, 6.0, 0.2
    exposures = np.array([10.0, 40.0, 160.0])
    light = np.random.default_rng(n).gamma(1.0, 0.3, (1, n)) * full
    stack = np.clip(black + light * exposures[:, None, None] / 40.0, 0, full).astype(dtype)
    merged, lost = call(
        "merge_exposures", stack=stack, exposures=exposures, black=black, full_scale=full,
        read_variance=read_variance, counts_per_electron=per_electron,
    )  # fmt: skip
    used = np.logical_and.accumulate(stack < 0.98 * full, axis=0)
    signal, time = (stack - black) * used, exposures[:, None, None] * used
    photon = np.maximum(signal.sum(axis=0) / np.maximum(time.sum(axis=0), 1.0), 0.0) * per_electron
    weight = used * exposures[:, None, None] / (read_variance + photon * exposures[:, None, None])
    rate = (weight * signal).sum(axis=0) / np.maximum((weight * time).sum(axis=0), 1e-300)
    share = np.where(used[0], np.clip(rate / ((full - black) / exposures[0]), 0.0, 1.0), 1.0)
    np.testing.assert_array_equal(merged, np.rint(share * 65535.0))
    assert lost == np.count_nonzero(~used[0])


def test_a_disc_is_the_sum_of_its_sources_spread() -> None:
    one = CALLS["render_disc"]
    found = call("render_disc")
    expected, slopes = np.zeros((12, 14)), []
    for (u, v), weight in zip(one["positions"], one["weights"], strict=True):
        x, y = np.array([one["x"], one["y"]]) + one["stretch"] @ (u, v)
        across = np.diff(ndtr((np.arange(15) - 0.5 - x) / one["psf"]))
        down = np.diff(ndtr((np.arange(13) - 0.5 - y) / one["psf"]))
        expected += weight * np.outer(down, across)
        slopes.append(u * weight * np.outer(down, across))
    np.testing.assert_allclose(found[0], expected, rtol=0, atol=2e-7)  # beyond five widths a source is dark
    np.testing.assert_allclose(found[4], np.sum(slopes, axis=0), rtol=0, atol=2e-7)
    step = 1e-5
    for plane, name in ((1, "x"), (2, "y"), (3, "psf")):
        ends = [call("render_disc", **{name: one[name] + side * step})[0] for side in (1.0, -1.0)]
        np.testing.assert_allclose(found[plane], (ends[0] - ends[1]) / (2.0 * step), rtol=0, atol=1e-6)


def test_the_smallest_values_of_a_mixture_have_their_part_of_its_mean() -> None:
    rng, shares, cosines = np.random.default_rng(8), np.array([0.0, 0.1, 0.4, 0.97, 1.0]), np.array([-0.9, 0.1, 0.9])
    roots = rng.standard_normal((40, 6, 2, 2)) * np.geomspace(1e-9, 1e9, 40)[:, None, None, None]
    moments, stated = roots @ roots.swapaxes(2, 3), np.eye(2) + 0.3
    share = rng.dirichlet(np.full(40, 0.2))
    low, high = np.linalg.eigvals(np.linalg.inv(stated) @ moments).real.swapaxes(0, 2).swapaxes(1, 2)[:, :, None]
    values = np.maximum(0.5 * (low + high) + 0.5 * np.abs(high - low) * cosines[:, None], 1e-6)
    expected = np.empty((6, 5))
    for place in range(6):
        ordered = np.argsort(values[..., place], axis=None)
        weight = np.repeat(share / 3.0, 3)[ordered]
        sums = np.cumsum(weight * values[..., place].ravel()[ordered])
        expected[place] = np.interp(shares, np.r_[0.0, np.cumsum(weight)], np.r_[0.0, sums])
    three, covariance = moments[:, :, [0, 0, 1], [0, 1, 1]].swapaxes(1, 2).copy(), np.array([1.3, 0.3, 1.3])
    found = _kernels.moments_below(three, share, np.tile(covariance[:, None], 6), cosines, shares, 1e-6)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize("free", [0, 4, 7])
def test_the_equations_of_a_point_spread_are_those_of_its_differences(free: int) -> None:
    given = CALLS["point_spread_equations"]

    def model(at: np.ndarray) -> np.ndarray:
        x, y, height, level, xx, xy, yy = (column[:, None] for column in at.T)
        dx, dy = given["x"] - x, given["y"] - y
        return np.asarray(height * np.exp(-0.5 * (xx * dx**2 + 2.0 * xy * dx * dy + yy * dy**2)) + level)

    chi2, normal, gradient = call("point_spread_equations", free=free)
    steps = 1e-6 * np.eye(7)[:free]
    slopes = (
        np.stack([(model(given["at"] + one) - model(given["at"] - one)) / 2e-6 for one in steps], axis=1)
        if free
        else np.zeros((N, 0, 9))
    )
    residual = given["value"] - model(given["at"])
    weighted = slopes * given["weight"][:, None]
    np.testing.assert_allclose(chi2, np.sum(residual**2 * given["weight"], axis=-1), rtol=1e-12)
    np.testing.assert_allclose(normal, weighted @ np.swapaxes(slopes, 1, 2), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(gradient, (weighted @ residual[..., None])[..., 0], rtol=1e-6, atol=1e-8)


def test_votes_of_pairs_are_counted_one_by_one_with_their_neighbours() -> None:
    rng = np.random.default_rng(8)
    tilts, bins, n = 5, 12, 40
    keys = rng.integers(0, tilts, 300) * 2 * bins + bins - rng.integers(0, bins, 300)
    first = rng.integers(0, 300, n)
    last = np.minimum(first + rng.integers(0, 60, n), 300)
    place = rng.integers(0, bins, n)
    votes = np.zeros((tilts, bins), dtype=np.int64)
    for begin, end, moved in zip(first, last, place, strict=True):
        for key in keys[begin:end]:
            tilt, at = divmod(int(key), 2 * bins)
            for side in (-1, 0, 1):
                votes[tilt, (at + moved + side) % bins] += 1
    found = _kernels.votes_of_pairs(keys, first, last, place, tilts, bins)
    np.testing.assert_array_equal(found, votes)


def test_points_of_another_number_of_unknowns_are_refused() -> None:
    with pytest.raises(ValueError, match=r".+"):
        call("point_spread_equations", free=5)
