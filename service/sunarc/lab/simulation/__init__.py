"""Simulated imager with a known camera: sky, lens, sensor and faults, in process or as a GigE Vision camera."""
