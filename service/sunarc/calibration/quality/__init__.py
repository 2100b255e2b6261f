"""Checks of data and of fits: day quality, fit verdict, acceptance, pose drift."""
