"""The composition root: the only place where parts are chosen and joined.

service.py: the parts of a running imager · serving.py: its life, from start to stop · status_line.py: what systemctl
shows · cameras.py: which camera the settings name · simulating.py: the simulated imager.
"""

from sunarc.app.cameras import camera_opener, require_stored_site
from sunarc.app.service import Service
from sunarc.app.serving import end_process, serve
from sunarc.app.simulating import simulate

__all__ = ["Service", "camera_opener", "end_process", "require_stored_site", "serve", "simulate"]
