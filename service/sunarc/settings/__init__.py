"""Settings: the rooms' own options, from a TOML file and SUNARC_* variables, parsed once at the top."""

from sunarc.settings.load import load_hub_settings, load_settings
from sunarc.settings.model import HubSettings, Settings
from sunarc.settings.reference import Setting, all_settings, as_markdown
from sunarc.settings.removed import REMOVED

__all__ = [
    "REMOVED",
    "HubSettings",
    "Setting",
    "Settings",
    "all_settings",
    "as_markdown",
    "load_hub_settings",
    "load_settings",
]
