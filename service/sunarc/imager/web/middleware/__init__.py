"""Limits and authentication applied to every request before a route sees it."""
