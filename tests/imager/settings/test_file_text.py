"""Values are set in place: comments, order, line ends and all other values stay."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from sunarc.common.errors import ConfigurationError, InputError
from sunarc.imager.settings.file_text import NEW_FILE, read_text, replace_values, value_in

EXAMPLE = Path(__file__).parents[3] / "deploy/sunarc.toml"


def test_a_value_is_changed_and_its_comment_and_every_other_line_kept() -> None:
    before = EXAMPLE.read_text()
    after = replace_values(before, {"site.longitude": 8.5})
    (changed,) = [(a, b) for a, b in zip(before.split("\n"), after.split("\n"), strict=True) if a != b]
    assert changed[1].startswith("longitude = 8.5 ")
    assert changed[0].partition("#")[2] == changed[1].partition("#")[2]


def test_the_same_value_changes_nothing() -> None:
    text = "name   =  'a'  # mine\n"
    assert replace_values(text, {"name": "a"}) == text


def test_a_commented_line_is_used_where_there_is_no_other() -> None:
    after = replace_values(EXAMPLE.read_text(), {"camera.binning": 2, "name": "roof"})
    assert "# binning" not in after
    assert "# name =" not in after
    assert len(after.split("\n")) == len(EXAMPLE.read_text().split("\n"))


def test_a_new_setting_stands_in_its_section_and_a_new_section_at_the_end() -> None:
    after = replace_values(
        'name = "a"\n\n[site]\nlatitude = 1.0\n\n[api]\nport = 1\n', {"site.altitude": 3.0, "x.y": True}
    )
    assert after.index("altitude") < after.index("[api]") < after.index("[x]")
    assert tomllib.loads(after) == {
        "name": "a",
        "site": {"latitude": 1.0, "altitude": 3.0},
        "api": {"port": 1},
        "x": {"y": True},
    }


@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ('name = "a # b" # c\n', "name", 'd "#" \\ e'),
        ("[site]\nlatitude = [\n 1, # one\n 2]\n[b]\nc = 1\n", "site.latitude", 2.0),
        ('a = """\n[site]\nlatitude = 1\n"""\n[site]\nlatitude = 2\n', "site.latitude", 3.0),
        ("[ site ]# x\r\nlatitude=1\r\n\r\n", "site.latitude", 3.0),
        ("", "source", "folder"),
        (NEW_FILE, "site.latitude", -3),
    ],
)
def test_only_what_is_asked_is_another_value(text: str, name: str, value: float | str) -> None:
    after = replace_values(text, {name: value})
    section, _, key = name.rpartition(".")
    wanted = tomllib.loads(text)
    (wanted.setdefault(section, {}) if section else wanted)[key] = value
    assert tomllib.loads(after) == wanted
    assert value_in(after, name) == value
    assert after.count("\r\n") == after.count("\n") or "\r" not in text


@pytest.mark.parametrize("text", ["site = {latitude = 1}\n", "site.latitude = 1\n", "[[site]]\nlatitude = 1\n"])
def test_a_form_that_cannot_be_changed_in_place_is_refused_by_its_setting(text: str) -> None:
    with pytest.raises(InputError) as refused:
        replace_values(text, {"site.latitude": 2})
    assert refused.value.field == "site.latitude"


def test_what_is_no_settings_file_is_refused_and_none_is_none(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    assert read_text(path) is None
    for content in (b"\xff\xfe", b"a = \n"):
        path.write_bytes(content)
        with pytest.raises(ConfigurationError):
            read_text(path)
