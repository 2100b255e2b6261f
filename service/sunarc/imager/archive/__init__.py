"""The database: cameras, pose epochs, sightings, days, calibrations, refits and events, in SQLite or PostgreSQL.

`archive` the class `Archive` · `values` its values · `sightings columns` cameras, epochs and
sightings · `calibrations calibration_rows` calibrations and their history · `days events` the record · `database/`
connections, tables, revisions, copies and recovery · `outbox feed_rows day_digests` rows for a hub · `images` files.
"""
