"""Geometric calibration of an all-sky imager from the sun, kept up to date without an operator.

The public names are those of `__init__.pyi`, loaded when they are used (docs/python.md).
"""

from importlib.metadata import version

import lazy_loader

__version__ = version("sunarc")
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
