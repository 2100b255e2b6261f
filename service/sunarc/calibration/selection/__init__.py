"""Selection of the sightings that a fit uses, by sky cell."""
