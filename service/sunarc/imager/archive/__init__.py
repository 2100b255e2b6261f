"""The database: cameras, pose epochs, sightings, days, calibrations, refits and events, in SQLite or PostgreSQL.

`archive` the class `Archive` · `values messages` what it stores and says · `sightings columns` cameras, pose epochs and
sightings · `calibrations calibration_rows` calibrations and their history · `days events` the record · `database/`
connections, tables, revisions, copies and recovery · `fleet/` between imagers and hubs · `images csv_files` files.
"""
