"""Supervisor, status registry, clock, systemd, scheduled jobs: what keeps the service running."""
