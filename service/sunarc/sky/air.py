"""How much air the sun's light comes through."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sunarc.sky.directions import FloatArray


def relative_air_mass(apparent_zenith: ArrayLike) -> FloatArray:
    """Return the air mass relative to the zenith's, (...); 38 at the horizon and below it.

    Parameters
    ----------
    apparent_zenith : (...) degrees.

    References
    ----------
    F. Kasten and A. T. Young, "Revised optical air mass tables and approximation formula", Applied Optics 28 (1989).
    """
    elevation = np.clip(90.0 - np.asarray(apparent_zenith, dtype=np.float64), 0.0, 90.0)
    return np.asarray(1.0 / (np.sin(np.radians(elevation)) + 0.50572 * (elevation + 6.07995) ** -1.6364))
