"""Checks of data and of fits: days, fit verdict, tilt, clock and site."""
