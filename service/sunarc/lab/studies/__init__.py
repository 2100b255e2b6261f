"""The paper's tables and figures, and plots of a calibration. matplotlib is imported when something is drawn."""
