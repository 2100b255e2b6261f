"""Keeps the geometric calibration of an all-sky imager right, from the sun."""

from importlib.metadata import version

__version__ = version("sunarc")
