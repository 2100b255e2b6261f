"""Service of one camera: capture, detection, refits, its archive and its web service."""
