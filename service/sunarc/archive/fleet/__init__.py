"""What imagers and hubs exchange: outbox, feeds, notices, and a hub's nightly work."""
