"""A first camera: from the sightings of a fit, from the image circle, or from one night's turning sky."""
