"""Settings: the rooms' own options, from a TOML file and SUNARC_* variables, parsed once at the top."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import ValidationError
from pydantic.fields import FieldInfo
from pydantic_settings import BaseSettings, InitSettingsSource, PydanticBaseSettingsSource, SettingsConfigDict

from sunarc.api import ApiOptions
from sunarc.archive import DiskOptions
from sunarc.calibration import CalibrationOptions, DayOptions
from sunarc.calibration.change_detection import WatchOptions
from sunarc.cameras import AravisOptions, ReplayOptions
from sunarc.detection import DiscOptions
from sunarc.errors import ConfigurationError, InputError
from sunarc.imaging import SunExposureOptions
from sunarc.runtime.supervisor import SupervisorOptions
from sunarc.sky import Site
from sunarc.workers import CaptureOptions, ClockOptions, RefitOptions, SensorOptions

_PREFIX = "SUNARC_"
_CONFIG_VARIABLE = "SUNARC_CONFIG"


class Settings(BaseSettings):
    """Everything that can be set, by section; unknown names are refused.

    Attributes
    ----------
    name : the camera's name in the archive and in documents.
    state : folder of the database and the images.
    source : where frames come from.
    site : where the camera stands.
    camera, replay : the GigE Vision camera, or the folder to replay.
    sensor, detection : the sensor's properties, and limits of the detection.
    capture, sun_exposure : the cycle, and the control of its sun exposures.
    clock : how the time of the frames is watched.
    calibration, refit, days : the fit, when and how it is run, and what makes a day clear.
    watch : thresholds of a change of the camera.
    disk : how much of the disk images may have.
    api : the web server.
    supervisor : limits of restarts and heartbeats of the workers.
    """

    model_config = SettingsConfigDict(extra="forbid", frozen=True)

    name: str = "imager"
    state: Path = Path("/var/lib/sunarc")
    source: Literal["aravis", "replay"] = "aravis"
    site: Site
    camera: AravisOptions | None = None
    replay: ReplayOptions | None = None
    sensor: SensorOptions = SensorOptions()
    detection: DiscOptions = DiscOptions()
    capture: CaptureOptions = CaptureOptions()
    sun_exposure: SunExposureOptions = SunExposureOptions()
    clock: ClockOptions = ClockOptions()
    calibration: CalibrationOptions = CalibrationOptions()
    refit: RefitOptions = RefitOptions()
    days: DayOptions = DayOptions()
    watch: WatchOptions = WatchOptions()
    disk: DiskOptions = DiskOptions()
    api: ApiOptions = ApiOptions()
    supervisor: SupervisorOptions = SupervisorOptions()

    @property
    def dated_by_camera(self) -> bool:
        """Whether frames are dated by the camera's own clock."""
        return self.camera is None or self.camera.timestamps == "camera"

    @property
    def database(self) -> Path:
        """The archive's file."""
        return self.state / "sunarc.sqlite"

    @property
    def backups(self) -> Path:
        """The folder of the dated copies of the archive."""
        return self.state / "backups"

    @property
    def reserve(self) -> Path:
        """The file that holds the database's room."""
        return self.state / "reserve"

    @property
    def images(self) -> Path:
        """The root of the dated image folders."""
        return self.state / "images"


class _Environment(PydanticBaseSettingsSource):
    """SUNARC_SECTION__NAME=value, where value is written as in TOML (or is a bare string)."""

    def get_field_value(self, field: FieldInfo, field_name: str) -> tuple[Any, str, bool]:  # noqa: ARG002 - protocol
        return None, field_name, False

    def __call__(self) -> dict[str, Any]:
        nested: dict[str, Any] = {}
        for variable, text in sorted(os.environ.items()):
            if not variable.startswith(_PREFIX) or variable == _CONFIG_VARIABLE:
                continue
            *sections, name = variable.removeprefix(_PREFIX).lower().split("__")
            place = nested
            for section in sections:
                place = place.setdefault(section, {})
            place[name] = _toml_value(text)
        return nested


def load_settings(path: Path | None, *, overrides: Mapping[str, Any] | None = None) -> Settings:
    """Read settings: overrides before the environment before the file before the defaults.

    Raises
    ------
    ConfigurationError : naming the file and the setting, in one line.
    """
    where = str(path) if path else "settings"
    stored = {} if path is None else _read_toml(path)

    class _FromFile(Settings):
        @classmethod
        def settings_customise_sources(
            cls,
            settings_cls: type[BaseSettings],
            init_settings: PydanticBaseSettingsSource,
            env_settings: PydanticBaseSettingsSource,  # noqa: ARG003 - protocol
            dotenv_settings: PydanticBaseSettingsSource,  # noqa: ARG003 - protocol
            file_secret_settings: PydanticBaseSettingsSource,  # noqa: ARG003 - protocol
        ) -> tuple[PydanticBaseSettingsSource, ...]:
            return init_settings, _Environment(settings_cls), InitSettingsSource(settings_cls, stored)

    try:
        return _FromFile(**dict(overrides or {}))
    except ValidationError as error:
        raise ConfigurationError(f"{where}: {_first_problem(error)}") from None
    except InputError as error:
        raise ConfigurationError(f"{where}: {error}") from None


def _read_toml(path: Path) -> dict[str, Any]:
    """Return a TOML file's content; a byte order mark and Windows line ends are accepted."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror}; name a settings file with --config") from None
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{path}: is not UTF-8 ({error.reason}); save it as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"{path}: is not TOML: {error}") from None


def _first_problem(error: ValidationError) -> str:
    problem = error.errors()[0]
    name = ".".join(str(part) for part in problem["loc"])
    others = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    match problem["type"]:
        case "extra_forbidden" | "unexpected_keyword_argument":
            return f"unknown setting {name}; remove it or correct its spelling{others}"
        case "missing":
            return f"setting {name} is missing; add it{others}"
        case _:
            return f"{name}: {problem['msg']}, not {problem['input']!r}{others}"


def _toml_value(text: str) -> Any:  # noqa: ANN401 - whatever TOML holds
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
