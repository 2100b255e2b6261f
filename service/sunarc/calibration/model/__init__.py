"""Values of a calibration: sightings, options, result, document, covariance, uncertainty maps."""
