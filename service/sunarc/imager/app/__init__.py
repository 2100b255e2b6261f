"""The composition root: the only package that chooses and joins parts.

`service` the parts of a running imager · `serving` start, run and stop · `status_line` the line of systemctl status ·
`hub` a hub · `cameras` the camera that the settings name · `simulating` the simulated imager.
"""
