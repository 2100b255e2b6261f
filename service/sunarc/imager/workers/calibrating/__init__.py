"""Day evaluation, refits, monitoring of the current calibration."""
