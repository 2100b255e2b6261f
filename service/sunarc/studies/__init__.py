"""The paper's tables and figures, and plots of a calibration. matplotlib is imported when something is drawn."""

from sunarc.studies.plots import write_calibration_plots
from sunarc.studies.tables import study_tables
from sunarc.studies.uncertainty import study_uncertainty

__all__ = ["study_tables", "study_uncertainty", "write_calibration_plots"]
