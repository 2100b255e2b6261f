"""The sun's disc in microsecond exposures."""
