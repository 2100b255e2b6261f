"""Values of a calibration: sightings, options, result, residual field, backward model, document."""
