"""The night: its exposures, its stars, and what it was like."""
