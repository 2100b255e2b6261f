"""Workers of the service: `capture`, `sightings`, `night`, `images`, `timing`, `calibrating`, `feeding`, `pushing`."""
