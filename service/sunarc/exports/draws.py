"""Draws of an ensemble as arrays: what every eighth pixel sees by each of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from sunarc.calibration.ensemble import draw_ensemble
from sunarc.calibration.model.document import from_document
from sunarc.errors import InputError
from sunarc.exports.discovery import Table, Variable
from sunarc.exports.tables import calibration_table

MOST_DRAWS_OF_A_FILE = 1000
"""A file of so many draws of a 2000 x 2000 image has 0.75 GB."""


def draws_table(document: Mapping[str, Any], *, draws: int, seed: int) -> Table:
    """Return a calibration's arrays with `direction_draw` (draw, y, x, component): unit vectors by each draw.

    Parameters
    ----------
    document : the calibration document; its id and the seed decide the draws, as over HTTP.
    draws : how many.
    seed : from 0.

    Raises
    ------
    InputError
        The number of draws or the seed is out of bounds, or the document is none.
    """
    if not 1 <= draws <= MOST_DRAWS_OF_A_FILE:
        remedy = f"give 1 to {MOST_DRAWS_OF_A_FILE}"
        raise InputError(field="--draws", problem=f"{draws} draws in one file", remedy=remedy)
    if seed < 0:
        raise InputError(field="--seed", problem=f"{seed} is negative", remedy="give 0 or more")
    calibration = from_document(document)
    table, _ = calibration_table(calibration, document)
    x, y = (table.variables[name].values.astype(np.float64) for name in ("x", "y"))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    ensemble = draw_ensemble(calibration, draws=draws, seed=seed, calibration_id=str(document["id"]))
    values = np.empty((draws, len(y), len(x), 3), dtype=np.float32)
    for draw in ensemble:
        values[draw] = ensemble.back_project(draw, grid).reshape(len(y), len(x), 3)
    attributes = {
        "units": "1",
        "long_name": "unit vector towards what the pixel sees by each draw, east-north-up",
        "camera_model": "camera",
        "coordinates": "component_name",
    }
    drawn = Variable(dimensions=("draw", "y", "x", "component"), values=values, attributes=attributes)
    return Table(
        variables={**table.variables, "direction_draw": drawn}, attributes={**table.attributes, "seed": np.int32(seed)}
    )
