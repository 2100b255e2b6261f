"""Changes of camera, clock and lens: evidence in a record, online, and between neighbours."""
