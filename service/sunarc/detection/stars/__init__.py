"""Stars in images of the night: background, matched filter, fit of the point spread; and which star is which."""
