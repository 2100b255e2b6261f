"""The paper's tables and figures made again, and the pictures of a calibration.

Map: `residuals`, `residual_plot`, `sky_plot`, `plots` the pictures of a calibration · `drawing` how a sheet looks.
"""

from sunarc.studies.plots import write_calibration_plots

__all__ = ["write_calibration_plots"]
