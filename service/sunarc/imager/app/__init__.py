"""Composition root of an imager: the only package that chooses and joins parts.

`service` the parts of a running imager · `serving` start, run and stop · `status_line` the line of systemctl status ·
`cameras` the camera that the settings name · `pushing` receivers of messages.
"""
