from __future__ import annotations

from pathlib import Path

import pytest

from sunarc.errors import ConfigurationError
from sunarc.settings import load_settings

SITE = "[site]\nlatitude = 36.6\nlongitude = -97.5\n"


def write(folder: Path, text: str) -> Path:
    path = folder / "sunarc.toml"
    path.write_text(text)
    return path


def test_sections_are_the_rooms_own_options(tmp_path: Path) -> None:
    settings = load_settings(write(tmp_path, SITE + "[capture]\ncadence_s = 60\nhdr_exposures_us = [100, 200]\n"))
    assert settings.capture.cadence_s == 60.0
    assert settings.capture.hdr_exposures_us == (100.0, 200.0)
    assert settings.site.latitude == 36.6


def test_the_environment_goes_before_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SUNARC_CAPTURE__CADENCE_S", "15")
    monkeypatch.setenv("SUNARC_CAPTURE__HDR_EXPOSURES_US", "[50, 600]")
    monkeypatch.setenv("SUNARC_NAME", "roof")
    settings = load_settings(write(tmp_path, SITE + "[capture]\ncadence_s = 60\n"))
    assert (settings.capture.cadence_s, settings.name) == (15.0, "roof")
    assert settings.capture.hdr_exposures_us == (50.0, 600.0)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (SITE + "[capture]\ncadance_s = 60\n", r"unknown setting capture\.cadance_s"),
        ("colour = 1\n" + SITE, "unknown setting colour"),
        (SITE + '[capture]\ncadence_s = "often"\n', r"capture\.cadence_s: .*number"),
        (SITE + "[capture]\ncadence_s = -3\n", "capture: a duration is not positive"),
        ("[site]\nlatitude = 136.6\nlongitude = -97.5\n", "site.latitude: 136.6 is not within -90 to 90"),
        (
            "[site]\nlatitude = 36.6\nlongitude = -97.5\ntemperature = 285.0\n",
            "site.temperature: 285.0 is not within -60 to 60; give degrees Celsius",
        ),
        (
            "[site]\nlatitude = 36.6\nlongitude = -97.5\npressure = 975.0\n",
            "site.pressure: 975.0 is not within 30000 to 110000; give pascals",
        ),
        ("", "setting site is missing"),
        ("[site\n", "is not TOML"),
    ],
)
def test_a_wrong_setting_is_named_in_one_line(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(ConfigurationError, match=told) as caught:
        load_settings(write(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_an_unknown_variable_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SUNARC_CAPTURE__CADANCE_S", "15")
    with pytest.raises(ConfigurationError, match=r"unknown setting capture\.cadance_s"):
        load_settings(write(tmp_path, SITE))


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"absent\.toml"):
        load_settings(tmp_path / "absent.toml")


def test_the_shipped_example_can_be_run_with() -> None:
    settings = load_settings(Path(__file__).parents[1] / "deploy" / "sunarc.toml")
    assert settings.camera is not None
    assert settings.camera.address == "192.168.0.2"
