"""The figures that `sunarc calibrate --plots` writes."""

from __future__ import annotations

from pathlib import Path

from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import SunPoints
from sunarc.extras import extra_module
from sunarc.studies.reports import writing_into
from sunarc.studies.residuals import residuals_of


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

    Raises
    ------
    InputError
        Where they cannot be written.
    """
    extra_module("matplotlib", extra="studies")  # loaded when something is drawn
    from sunarc.studies.drawing import save_png  # noqa: PLC0415 - same
    from sunarc.studies.residual_plot import residual_figure  # noqa: PLC0415 - same
    from sunarc.studies.sky_plot import sky_figure  # noqa: PLC0415 - same

    residuals = residuals_of(calibration, points)
    with writing_into(folder):
        return (
            save_png(residual_figure(calibration, residuals), folder / "residuals.png"),
            save_png(sky_figure(calibration, residuals), folder / "sky.png"),
        )
