"""The parameter that chooses a calibration, for the routes that answer with one."""

from __future__ import annotations

from fastapi import Depends

from sunarc.api.schemas.parameters import Chosen


def _chosen(_calibration: Chosen = None) -> None:
    """Describe the parameter; `ApiContext.of` reads it."""


BY_CALIBRATION = [Depends(_chosen)]
"""Dependencies of a route that answers with a calibration."""
