"""Initial values of a fit: image circle, coarse search, RANSAC, multistart."""
