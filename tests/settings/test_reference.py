"""`sunarc settings` prints every setting; docs/settings.md is what it prints."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from sunarc.settings import all_settings, as_markdown
from sunarc.settings.reference import attributes_of

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

ROOT = Path(__file__).parents[2]


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
    assert by_name["camera.transport"]["allowed"] == 'one of "gige", "usb3"'


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
    assert attributes_of(Documented) == {
        "first": "two of them, on two lines.",
        "second": "two of them, on two lines.",
        "third": "one.",
    }
