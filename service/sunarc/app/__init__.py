"""The composition root: the only room that chooses and joins parts.

`service` the parts of a running imager · `serving` start, run and stop · `status_line` the line of systemctl status ·
`hub` a hub · `cameras` the camera that the settings name · `simulating` the simulated imager.
"""

from sunarc.app.cameras import camera_opener, require_stored_site
from sunarc.app.hub import serve_hub
from sunarc.app.night import night_capture
from sunarc.app.pushing import receivers
from sunarc.app.service import Service
from sunarc.app.serving import end_process, serve, with_credentials
from sunarc.app.simulating import simulate
from sunarc.simulation import ImagerOptions, NightOptions, SceneOptions, SensorModel

__all__ = [
    "ImagerOptions",
    "NightOptions",
    "SceneOptions",
    "SensorModel",
    "Service",
    "camera_opener",
    "end_process",
    "night_capture",
    "receivers",
    "require_stored_site",
    "serve",
    "serve_hub",
    "simulate",
    "with_credentials",
]
