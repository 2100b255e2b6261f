"""Checks of an installation and of its camera, for `sunarc check`."""
