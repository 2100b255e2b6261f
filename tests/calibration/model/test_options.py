"""Bounds of the options: the defaults, what is refused, and what is allowed at the bound."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import pytest

from sunarc.calibration.model.options import CalibrationOptions, ImageCircle, LensTolerances, PaperOptions
from sunarc.common.errors import InputError


def _made(kind: type[Any], name: str, value: object) -> Any:  # noqa: ANN401 - one of several options
    return kind(**{name: value})


@pytest.mark.parametrize("name", [field.name for field in fields(LensTolerances)])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_tolerances_are_positive(name: str, value: float) -> None:
    with pytest.raises(InputError, match=name):
        _made(LensTolerances, name, value)


@pytest.mark.parametrize(
    "name",
    [
        "level_within_deg",
        "max_angle_deg",
        "max_rmse_px",
        "max_rejected",
        "max_sky_deg",
        "max_unexplained",
        "max_below_horizon",
    ],
)
def test_limits_of_a_fit_are_positive(name: str) -> None:
    for value in (0.0, -1.0, math.nan):
        with pytest.raises(InputError, match=name):
            _made(CalibrationOptions, name, value)
    assert getattr(_made(CalibrationOptions, name, 1e-3), name) == 1e-3


@pytest.mark.parametrize("name", ["site_error_m", "field_floor_px"])
def test_errors_are_not_negative(name: str) -> None:
    for value in (-1e-9, math.nan, math.inf):
        with pytest.raises(InputError, match=name):
            _made(CalibrationOptions, name, value)
    assert getattr(_made(CalibrationOptions, name, 0.0), name) == 0.0


@pytest.mark.parametrize(("name", "value"), [("method", "best"), ("projection", "fisheye"), ("mirrored", "maybe")])
def test_choices_that_are_none_are_refused(name: str, value: str) -> None:
    with pytest.raises(InputError, match=name):
        _made(CalibrationOptions, name, value)


def test_the_paper_s_choices_are_bounded() -> None:
    with pytest.raises(InputError):
        PaperOptions(pose_start="guess")  # type: ignore[arg-type]
    with pytest.raises(InputError):
        PaperOptions(ellipse_scope="all")  # type: ignore[arg-type]
    for name in ("orthogonality_weight", "circularity_weight", "monotony_weight"):
        with pytest.raises(InputError, match=name):
            _made(PaperOptions, name, -1.0)
        with pytest.raises(InputError, match=name):
            _made(PaperOptions, name, math.nan)
        assert getattr(_made(PaperOptions, name, 0.0), name) == 0.0


@pytest.mark.parametrize(
    "wrong",
    [{"x": math.nan}, {"y": math.inf}, {"radius": 0.0}, {"radius": -3.0}, {"angle_deg": 0.0}, {"angle_deg": math.nan}],
)
def test_what_is_no_circle_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError):
        ImageCircle(**({"x": 10.0, "y": 10.0, "radius": 5.0} | wrong))


def test_the_defaults_are_those_of_the_documents() -> None:
    """Each is written down: a change of a default is a change of every fit."""
    options, lens, paper = CalibrationOptions(), LensTolerances(), PaperOptions()
    assert (options.method, options.projection, options.mirrored) == ("robust", "auto", None)
    assert (options.level_within_deg, options.max_angle_deg, options.max_rmse_px) == (None, 100.0, 3.0)
    assert (options.max_rejected, options.max_sky_deg) == (0.6, 1.5)
    assert (options.max_unexplained, options.max_below_horizon) == (0.25, 0.03)
    assert (options.site_error_m, options.field_floor_px) == (30.0, 0.002)
    assert (lens.radial_px, lens.radial_length_deg, lens.decentering_px, lens.decentering_higher) == (
        7.0,
        34.0,
        1.2,
        0.3,
    )
    assert (lens.skew_px, lens.aspect_px) == (0.01, 0.02)
    assert (lens.circle_center_px, lens.circle_focal_length_px) == (5.0, 12.0)
    assert (lens.center_fraction, lens.focal_length_fraction) == (0.03, 0.3)
    assert (paper.orthogonality_weight, paper.circularity_weight, paper.monotony_weight) == (1e3, 750.0, 1e3)
    assert ImageCircle(x=0.0, y=0.0, radius=1.0).angle_deg == 90.0
