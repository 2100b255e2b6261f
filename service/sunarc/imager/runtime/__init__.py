"""Supervisor, status registry, clock, systemd, scheduled jobs: the parts that keep the service running."""
