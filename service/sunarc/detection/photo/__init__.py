"""The sun in ordinary exposures."""
