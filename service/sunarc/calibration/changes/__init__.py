"""Changes of camera, clock or site: between one sighting and the next, and within a record."""
