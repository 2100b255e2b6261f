"""Checks of data and of fits: days, fit verdict, acceptance, clock and site."""
