"""Every setting: what is out of bounds, of a wrong type, misspelt or gone is refused with its dotted path."""

from __future__ import annotations

import json
import os
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from annotated_types import Ge, Gt, Le, Lt

from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.selection import SelectionOptions
from sunarc.changes.values import WatchOptions
from sunarc.common.bounds import OneOf, declared_bounds
from sunarc.common.errors import ConfigurationError, InputError
from sunarc.common.foreign_files import MOST_SETTINGS_BYTES
from sunarc.detection.values import DiscOptions
from sunarc.imager.cameras.options import AravisOptions
from sunarc.imager.runtime.supervisor import SupervisorOptions
from sunarc.imager.settings.file_text import read_text
from sunarc.imager.settings.load import load_hub_settings, load_settings
from sunarc.imager.settings.model import Settings
from sunarc.imager.settings.reference import all_settings, dataclass_in
from sunarc.imager.workers.options import CaptureOptions, RefitOptions
from sunarc.imaging.exposure import SunExposureOptions
from sunarc.sky.site import Site

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sunarc.common.bounds import Bound

SITE = "[site]\nlatitude = 36.6\nlongitude = -97.5\n"
ROOT = Path(__file__).parents[3]
STORED = Path(__file__).with_name("settings_0.2.0.toml")
ALLOWED = {setting.name: setting.allowed for setting in all_settings()}
NAMES = list(ALLOWED)
REQUIRED = {
    "folder": {"path": "/images"},
    "http": {"url": "http://camera.example/snapshot.jpg"},
    "rtsp": {"url": "rtsp://camera.example/stream1"},
}
"""Of sections that came after 0.2.0."""


def bounds_by_name() -> dict[str, tuple[Bound, ...]]:
    """Return the declared bounds of every setting in a section."""
    sections = {name: dataclass_in(field.annotation) for name, field in Settings.model_fields.items()}
    found = {
        f"{section}.{field}": bounds
        for section, options in sections.items()
        if options is not None
        for field, bounds in declared_bounds(options).items()
    }
    return {name: found.get(name, ()) for name in NAMES}


BOUNDS = bounds_by_name()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("settings")


def write(folder: Path, text: str) -> Path:
    path = folder / "sunarc.toml"
    path.write_text(text)
    return path


def stored_with(folder: Path, name: str, value: str) -> Path:
    """Write the stored settings with one value in place of another; `name` may be new."""
    tables = tomllib.loads(STORED.read_text())
    section, _, key = name.rpartition(".")
    table = tables.setdefault(section, dict(REQUIRED.get(section, {}))) if section else tables
    table.pop(key, None)
    lines = [f"{key} = {value}"] if not section else []
    lines += [f"{one} = {json.dumps(other)}" for one, other in tables.items() if not isinstance(other, dict)]
    for one, other in tables.items():
        if isinstance(other, dict):
            lines += [f"[{one}]", *(f"{field} = {json.dumps(given)}" for field, given in other.items())]
            lines += [f"{key} = {value}"] if one == section else []
    return write(folder, "\n".join(lines) + "\n")


def refusal(path: Path) -> str:
    with pytest.raises(ConfigurationError) as refused:
        load_settings(path)
    text = str(refused.value)
    assert "\n" not in text
    return text.removeprefix(f"{path}: ")


def in_toml(name: str, text: str) -> str:
    """Write a value as the setting's list where it is one."""
    section, _, key = name.rpartition(".")
    value = tomllib.loads(STORED.read_text()).get(section, {}).get(key)
    return f"[{', '.join([text] * len(value))}]" if isinstance(value, list) else text


def beyond(bounds: tuple[Bound, ...]) -> Iterator[float]:
    """Yield a number beyond each bound, and the bound itself where it is excluded."""
    for bound in bounds:
        match bound:
            case Gt(gt=limit) | Lt(lt=limit):
                yield float(limit)  # type: ignore[arg-type]
            case Ge(ge=limit):
                yield float(limit) - 1.0  # type: ignore[arg-type]
            case Le(le=limit):
                yield float(limit) + 1.0  # type: ignore[arg-type]


NUMERIC = [name for name, allowed in ALLOWED.items() if "number" in allowed]


_NEW_SECTIONS = ("folder.", "http.", "rtsp.", "push.", "night.", "nightly.", "first_pose.")
NEW = {"store", "hub.url", "hub.token_file", "site.timezone", "calibration.outwards_px"} | {
    name for name in NAMES if name.startswith(_NEW_SECTIONS)
}
"""Settings that came after 0.2.0."""


def test_a_settings_file_of_0_2_0_is_read_and_has_every_setting() -> None:
    tables = tomllib.loads(STORED.read_text())
    names = {f"{section}.{key}" for section, table in tables.items() if isinstance(table, dict) for key in table}
    assert names | {name for name, value in tables.items() if not isinstance(value, dict)} == set(NAMES) - NEW
    settings = load_settings(STORED)
    assert settings.camera is not None
    assert settings.replay is not None
    for section, table in tables.items():
        for key, value in table.items() if isinstance(table, dict) else ():
            given = getattr(getattr(settings, section), key)
            plain = list(given) if isinstance(given, tuple) else str(given) if isinstance(given, Path) else given
            assert plain == value, f"{section}.{key}"


def test_there_are_about_fifty_settings() -> None:
    assert len(NAMES) <= 89


def test_every_number_has_a_lower_and_an_upper_bound() -> None:
    assert [name for name in NUMERIC if len(dict.fromkeys(BOUNDS[name])) != 2] == []


@pytest.mark.parametrize("name", NUMERIC)
def test_a_number_out_of_bounds_or_not_finite_is_refused_by_its_path(folder: Path, name: str) -> None:
    whole = name in {"camera.packet_size", "camera.binning", "camera.region", "api.port"}
    for number in dict.fromkeys(beyond(BOUNDS[name])):
        given = str(int(number) if whole else number)
        text = refusal(stored_with(folder, name, in_toml(name, given)))
        assert text.startswith(f"{name}: {given} is ")
    for given in ("nan", "inf", "true", '"12"'):
        assert refusal(stored_with(folder, name, in_toml(name, given))).startswith(f"{name}: ")


@pytest.mark.parametrize("name", NAMES)
def test_a_value_of_a_wrong_type_is_refused_by_its_path(folder: Path, name: str) -> None:
    for wrong in ("1979-05-27", "true") if "number" in ALLOWED[name] else ("1.5", "[[1]]"):
        text = refusal(stored_with(folder, name, wrong))
        assert text.startswith(f"{name}: ")
        assert text.endswith(f"give {ALLOWED[name]}")


@pytest.mark.parametrize("name", [name for name, bounds in BOUNDS.items() if any(isinstance(b, OneOf) for b in bounds)])
def test_a_choice_that_is_none_is_refused_with_the_choices(folder: Path, name: str) -> None:
    text = refusal(stored_with(folder, name, '"other"'))
    assert text.startswith(f"{name}: ")
    assert ALLOWED[name] in text


@pytest.mark.parametrize("name", NAMES)
def test_a_misspelt_name_is_refused_by_its_path(folder: Path, name: str) -> None:
    text = refusal(stored_with(folder, f"{name}x", "1"))
    assert text.startswith(f"{name}x: ")
    assert name in text.removeprefix(f"{name}x: ")  # the nearest name is suggested


@pytest.mark.parametrize(
    "name",
    [
        "detection.min_snr",
        "days.clear_share",
        "api.burst",
        "calibration.paper.pose_start",
        "calibration.tolerances.skew_px",
    ],
)
def test_what_was_a_setting_of_0_2_0_or_is_for_python_only_is_refused(folder: Path, name: str) -> None:
    assert refusal(write(folder, f"{name} = 1\n{SITE}")).startswith(f"{name}: ")


@pytest.mark.parametrize("name", ["state", "capture.cadence_s"])
def test_an_empty_table_in_place_of_a_value_is_refused(folder: Path, name: str) -> None:
    assert refusal(write(folder, f"{name} = {{}}\n{SITE}")).startswith(f"{name}: ")


def test_sections_whose_settings_are_all_commented_out_are_read(folder: Path) -> None:
    assert load_settings(write(folder, f"{SITE}[capture]\n")).capture == CaptureOptions()


@pytest.mark.parametrize("section", ["days", "refit.selection", "calibration.paper"])
def test_a_section_that_is_no_more_is_refused_even_empty(folder: Path, section: str) -> None:
    assert refusal(write(folder, f"{SITE}[{section}]\n")).startswith(f"{section}: ")


def test_a_variable_that_is_no_setting_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SUNARC_CALIBRATION__FREE", "pose")
    assert refusal(write(folder, SITE)).startswith("calibration.free: ")


@pytest.mark.parametrize(
    ("options", "given", "field"),
    [
        (DiscOptions, {"clear_level_per_us": -5.0}, "detection.clear_level_per_us"),
        (CaptureOptions, {"sun_zenith_deg": 500.0}, "capture.sun_zenith_deg"),
        (CaptureOptions, {"reopen_after_s": -5.0}, "capture.reopen_after_s"),
        (CaptureOptions, {"reopen_after_s": 0.0}, "capture.reopen_after_s"),
        (CaptureOptions, {"hdr_exposures_us": ()}, "capture.hdr_exposures_us"),
        (AravisOptions, {"address": "192.0.2.7", "answer_timeout_s": 0.0}, "camera.answer_timeout_s"),
        (CalibrationOptions, {"method": "guess"}, "calibration.method"),
        (SelectionOptions, {"most": 0}, "refit.selection.most"),
        (RefitOptions, {"image_circle_px": (1.0, 1.0, 0.0)}, "refit.image_circle_px"),
        (SunExposureOptions, {"target_low": 0.8}, "sun_exposure.target_low"),
        (SupervisorOptions, {"stale_after_s": 4.9}, "supervisor.stale_after_s"),
        (WatchOptions, {"wander_deg": 5.1}, "watch.wander_deg"),
    ],
)
def test_options_made_in_python_are_refused_by_the_same_path(options: Any, given: dict[str, Any], field: str) -> None:  # noqa: ANN401 - any options
    with pytest.raises(InputError) as refused:
        options(**given)
    assert refused.value.field == field


def test_the_defaults_are_within_their_bounds() -> None:
    assert Settings.model_validate_json(load_settings(STORED).model_dump_json()) == load_settings(STORED)


def test_the_environment_goes_before_the_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SUNARC_CAPTURE__CADENCE_S", "15")
    monkeypatch.setenv("SUNARC_CAPTURE__HDR_EXPOSURES_US", "[50, 600]")
    monkeypatch.setenv("SUNARC_NAME", "roof")
    settings = load_settings(write(folder, SITE + "[capture]\ncadence_s = 60\nsun_zenith_deg = 80\n"))
    assert (settings.capture.cadence_s, settings.capture.sun_zenith_deg, settings.name) == (15.0, 80.0, "roof")
    assert settings.capture.hdr_exposures_us == (50.0, 600.0)


def test_an_unknown_variable_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SUNARC_CAPTURE__CADANCE_S", "15")
    assert refusal(write(folder, SITE)).startswith("capture.cadance_s: ")


@pytest.mark.parametrize(
    ("text", "start"),
    [
        ("colour = 1\n" + SITE, "colour: "),
        (SITE + "[capture]\ncadence_s = -3\n", "capture.cadence_s: -3"),
        (SITE + "[capture.more]\ncadence_s = 3\n", "capture.more.cadence_s: "),
        ("capture = 3\n" + SITE, "capture: "),
        (SITE + "[day]\n", "day: "),
        ("", "setting site is missing"),
        ("[site]\nlatitude = 36.6\n", "setting site.longitude is missing"),
        ("[site\n", "is not TOML"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(folder: Path, text: str, start: str) -> None:
    assert refusal(write(folder, text)).startswith(start)


@pytest.mark.parametrize(
    ("data", "name"),
    [
        (b"\xef\xbb\xbfname = 'mast'\n" + SITE.encode(), "mast"),
        (("name = 'mast'\n" + SITE).replace("\n", "\r\n").encode(), "mast"),
        (b"\xef\xbb\xbf" + SITE.replace("\n", "\r\n").encode(), "imager"),
    ],
)
def test_a_byte_order_mark_and_windows_line_ends_are_read(folder: Path, data: bytes, name: str) -> None:
    path = folder / "sunarc.toml"
    path.write_bytes(data)
    assert load_settings(path).name == name


@pytest.mark.parametrize("data", [("name = 'm\xe4st'\n" + SITE).encode("latin-1"), SITE.encode("utf-16")])
def test_a_file_that_is_not_utf_8_is_refused_in_one_line(folder: Path, data: bytes) -> None:
    path = folder / "sunarc.toml"
    path.write_bytes(data)
    assert refusal(path).startswith("is not UTF-8")


def test_a_file_that_is_not_there_is_named(folder: Path) -> None:
    assert refusal(folder / "absent.toml").endswith("--config")


def test_the_shipped_example_can_be_run_with_and_names_settings_alone() -> None:
    path = ROOT / "deploy" / "sunarc.toml"
    settings = load_settings(path)
    assert settings.camera is not None
    assert settings.camera.address == "192.168.0.2"
    section, names = "", set()
    for line in path.read_text().splitlines()[2:]:
        bare = line.removeprefix("# ")
        if bare.startswith("["):
            section = bare[1 : bare.index("]")] + "."
        elif " = " in bare:
            names.add(section + bare.partition(" = ")[0])
    assert names - set(NAMES) == set()


@pytest.mark.parametrize("kind", ["pipe", "zero", "large"])
@pytest.mark.parametrize("read", [load_settings, load_hub_settings, read_text])
def test_only_a_regular_file_of_a_bounded_size_is_read(
    tmp_path: Path, kind: str, read: Callable[[Path], object]
) -> None:
    path = tmp_path / "sunarc.toml"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "zero":
        path.symlink_to("/dev/zero")
    else:
        path.write_bytes(b"#" * (MOST_SETTINGS_BYTES + 1))
    with pytest.raises(ConfigurationError, match="larger than" if kind == "large" else "not a regular file"):
        read(path)


@pytest.mark.parametrize("zone", ["Mars/Olympus", "", "../etc", "Europe", "/etc/passwd", "CEST"])
def test_a_time_zone_that_does_not_exist_is_refused_by_its_path(folder: Path, zone: str) -> None:
    (folder / "sunarc.toml").write_text(SITE + f'timezone = "{zone}"\n')
    with pytest.raises(ConfigurationError, match=r"site\.timezone: .* is not a time zone") as refused:
        load_settings(folder / "sunarc.toml")
    assert "\n" not in str(refused.value)


def test_the_time_zone_is_utc_unless_it_is_set(folder: Path) -> None:
    path = folder / "sunarc.toml"
    path.write_text(SITE)
    assert load_settings(path).site.timezone == "UTC"
    path.write_text(SITE + 'timezone = "Pacific/Auckland"\n')
    settings = load_settings(path)
    assert settings.site.timezone == "Pacific/Auckland"
    plain = Site(latitude=36.6, longitude=-97.5)
    assert Settings(site=plain).site == replace(settings.site, timezone="UTC")
