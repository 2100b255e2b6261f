"""Capture loop: exposure sequence, sun exposure control, consistency of cycles."""
