"""From frames to stored sightings."""
