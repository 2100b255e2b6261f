"""Lenses of one type: what several cameras say of it, and what a fit or a pose gains from that."""
