"""What keeps the service running: supervisor, status registry, clock, systemd, scheduled jobs, preflight checks."""
