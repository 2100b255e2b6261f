"""The stars of a night and a camera: where it sees them, which detections they are, and a camera by them alone."""
