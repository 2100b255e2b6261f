"""Exposure control for the sun, checks of frame brightness, and the HDR merge; pure functions."""
