"""A first camera: from the sightings of a fit, or from the image circle."""
