"""The moon in its own short exposure: a fit of its lit part, which gives the centre of the whole disc."""
