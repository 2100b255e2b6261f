"""Geometric calibration of an all-sky imager from the sun, kept up to date without an operator."""

from importlib.metadata import version

__version__ = version("sunarc")
