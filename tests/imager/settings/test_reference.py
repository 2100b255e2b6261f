"""`sunarc settings` prints every setting; docs/settings.md is what it prints."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import pytest
from annotated_types import Gt, Le

from sunarc.imager.archive.day_digests import LEAST_KEPT
from sunarc.imager.settings.reference import (
    all_settings,
    as_markdown,
    dataclass_in,
    documented_attributes,
    list_settings,
    toml_text,
    type_name,
)

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

ROOT = Path(__file__).parents[3]


def test_every_setting_has_a_meaning() -> None:
    assert [setting.name for setting in all_settings() if not setting.meaning] == []


def test_the_page_is_that_of_this_version() -> None:
    page = (ROOT / "docs" / "settings.md").read_text(encoding="utf-8")
    assert page == as_markdown(), "run: sunarc settings > docs/settings.md"


def test_the_command_prints_the_same_settings_as_json(sunarc: Sunarc) -> None:
    printed = json.loads(sunarc("settings", "--json").out)
    assert [row["name"] for row in printed] == [setting.name for setting in all_settings()]
    by_name = {row["name"]: row for row in printed}
    assert by_name["site.latitude"]["default"] == "required"
    assert by_name["capture.cadence_s"]["default"] == "30.0"
    assert re.findall('"(.*?)"', by_name["camera.transport"]["allowed"]) == ["gige", "usb3"]


def test_an_attribute_section_is_read_over_several_lines() -> None:
    class Documented:
        """Something.

        Attributes
        ----------
        first, second : two of them,
            on two lines.
        third : one.
        """

    Documented.__doc__ = (Documented.__doc__ or "").replace("\n    ", "\n")  # as at the top level of a module
    assert documented_attributes(Documented) == {
        "first": "two of them, on two lines.",
        "second": "two of them, on two lines.",
        "third": "one.",
    }


@dataclass(frozen=True)
class Inner:
    """Options within options.

    Attributes
    ----------
    depth : how deep, m.
    """

    depth: Annotated[float, Gt(0.0), Le(9.0)] = 2.0


@dataclass(frozen=True)
class Outer:
    """Options of every kind.

    Attributes
    ----------
    size : px.
    levels : several.
    kind : which.
    """

    size: int
    levels: tuple[float, ...] = (0.5, 1.0)
    kind: Literal["a", "b"] = "a"
    inner: Inner = field(default_factory=Inner)


def test_options_within_options_get_a_dotted_path_in_the_order_of_the_fields() -> None:
    names = [setting.name for setting in list_settings(Outer, "outer")]
    assert names == ["outer.size", "outer.levels", "outer.kind", "outer.inner.depth"]


def test_each_setting_has_its_default_bounds_and_meaning() -> None:
    found = {one.name: (one.default, one.allowed, one.meaning) for one in list_settings(Outer, "outer")}
    assert found["outer.size"] == ("required", "a whole number", "px.")
    assert found["outer.levels"] == ("[0.5, 1.0]", "a list of numbers", "several.")
    assert found["outer.kind"] == ('"a"', 'one of "a", "b"', "which.")
    assert found["outer.inner.depth"] == ("2.0", "a number above 0 and at most 9", "how deep, m.")


@pytest.mark.parametrize(
    ("annotation", "name"),
    [
        (str, "text"),
        (bool, "true or false"),
        (Path | None, "a path"),
        (float | int, "a number or a whole number"),
        (tuple[int, int, int, int], "a list of 4 whole numbers"),
        (tuple[float, ...] | None, "a list of numbers"),
    ],
)
def test_a_type_is_named_as_toml_has_it(annotation: Any, name: str) -> None:  # noqa: ANN401 - any annotation
    assert type_name(annotation) == name


@pytest.mark.parametrize("value", [True, False, 3, 2.5, "text", (1, 2), Path("/var/lib")])
def test_a_default_is_written_so_that_toml_reads_it_back(value: object) -> None:
    read = tomllib.loads(f"value = {toml_text(value)}")["value"]
    assert read == (list(value) if isinstance(value, tuple) else str(value) if isinstance(value, Path) else value)


def test_a_default_of_none_is_unset() -> None:
    assert toml_text(None) == "unset"


def test_the_class_of_an_option_is_found_beside_none() -> None:
    assert dataclass_in(Inner | None) is Inner
    assert dataclass_in(float | None) is None


def test_the_page_has_one_row_for_each_setting() -> None:
    rows = [line.split("`")[1] for line in as_markdown().splitlines() if line.startswith("| `")]
    assert sorted(rows) == sorted(setting.name for setting in all_settings())


def test_the_settings_load_neither_the_fit_nor_a_worker() -> None:
    heavy = (
        "numba",
        "scipy",
        "cv2",
        "sunarc.calibration.fit",
        "sunarc.calibration.calibrate",
        "sunarc.imager.workers.capture",
    )
    code = f"import sys, sunarc.imager.settings.load; print([name for name in {heavy} if name in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_a_hub_keeps_at_least_what_its_archive_needs() -> None:
    least = next(setting for setting in all_settings() if setting.name == "nightly.keep_sightings_days").allowed
    assert f"{LEAST_KEPT / timedelta(days=1):g}" in least.split()
