"""Detection of the sun: `disc` in microsecond exposures, `photo` in ordinary ones; `stars` and `moon` at night."""
