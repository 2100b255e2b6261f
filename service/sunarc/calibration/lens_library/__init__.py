"""Lenses of one type: the prior that several cameras give, and its use in a fit or a pose."""
