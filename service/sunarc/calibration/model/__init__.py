"""Values of a calibration: sightings, options, result, residual field."""
