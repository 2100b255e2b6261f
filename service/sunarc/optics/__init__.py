"""Camera model: projection, back-projection and derivatives."""
