"""The night: its exposures, its stars, and its verdict."""
