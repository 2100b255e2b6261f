"""Composites and their metadata."""
