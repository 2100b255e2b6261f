"""Sending of the archive's rows to a hub: `feed` the worker · `hub_connection` its requests."""
