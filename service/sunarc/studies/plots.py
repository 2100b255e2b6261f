"""The figures that `sunarc calibrate --plots` writes."""

from __future__ import annotations

from pathlib import Path

from sunarc.calibration import Calibration, SunPoints
from sunarc.studies.drawing import save_png
from sunarc.studies.residual_plot import residual_figure
from sunarc.studies.residuals import residuals_of
from sunarc.studies.sky_plot import sky_figure


def write_calibration_plots(calibration: Calibration, points: SunPoints, *, folder: Path) -> tuple[Path, ...]:
    """Write what a calibration leaves over and how sure it is, as PNG.

    Parameters
    ----------
    calibration : accepted or refused.
    points : the sightings that it was made from.
    folder : where to; made where it is missing.

    Returns
    -------
    The files: `residuals.png` and `sky.png`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    residuals = residuals_of(calibration, points)
    return (
        save_png(residual_figure(calibration, residuals), folder / "residuals.png"),
        save_png(sky_figure(calibration, residuals), folder / "sky.png"),
    )
