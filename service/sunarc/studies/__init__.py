"""The paper's tables and figures made again, and the pictures of a calibration.

Map: `residuals`, `residual_plot`, `sky_plot`, `plots` the pictures of a calibration · `published` the paper's numbers ·
`arcs`, `noise` what is simulated · `trials`, `bound`, `uncertainty`, `uncertainty_plot` Figs. 4 and 5 · `tables` Tables
1 to 3 · `drawing` how a sheet looks · `reports` the files · `command_line` the command.

Nothing here loads matplotlib before something is drawn.
"""

from sunarc.studies.plots import write_calibration_plots
from sunarc.studies.tables import study_tables
from sunarc.studies.uncertainty import study_uncertainty

__all__ = ["study_tables", "study_uncertainty", "write_calibration_plots"]
