from __future__ import annotations

import re

import pytest

from sunarc.common import errors
from sunarc.common.errors import InputError, NotFoundError, SunarcError

CLASSES = {
    name: thing
    for name, thing in vars(errors).items()
    if getattr(thing, "__module__", "") == errors.__name__ and isinstance(thing, type)
}


def test_an_input_error_says_where_what_and_the_remedy_in_one_line() -> None:
    error = InputError(field="row 3, x_px", problem="'abc' is no number", remedy="write pixels as decimal numbers")
    assert re.split("[:;] ", str(error)) == [error.field, error.problem, error.remedy]
    assert (error.field, error.problem, error.remedy) == (
        "row 3, x_px",
        "'abc' is no number",
        "write pixels as decimal numbers",
    )


def test_the_tree_in_the_docstring_is_the_tree() -> None:
    drawn = [(m.start(1) // 4, m[1]) for m in re.finditer(r"(?m)^ {4}.*?\b(\w+Error)\b", errors.__doc__ or "")]
    names = re.findall(r"(\w+Error)\b", errors.__doc__ or "")
    assert len(drawn) == len(names)
    assert set(names) == set(CLASSES)


@pytest.mark.parametrize(
    ("child", "parent"),
    [
        ("InputError", "SunarcError"),
        ("NotFoundError", "InputError"),
        ("ConfigurationError", "SunarcError"),
        ("SchemaError", "ConfigurationError"),
        ("OutsideError", "SunarcError"),
        ("CameraError", "SunarcError"),
        ("CameraTimeoutError", "CameraError"),
        ("CameraLostError", "CameraError"),
    ],
)
def test_each_error_is_caught_with_its_kind(child: str, parent: str) -> None:
    assert CLASSES[child].__bases__ == (CLASSES[parent],)


def test_what_is_missing_is_an_input_error_too() -> None:
    with pytest.raises(InputError, check=lambda error: error.field == "calibration"):
        raise NotFoundError(field="calibration", problem="there is none", remedy="wait for a clear day")


def test_every_error_has_one_root() -> None:
    assert [name for name, thing in CLASSES.items() if not issubclass(thing, SunarcError)] == []
