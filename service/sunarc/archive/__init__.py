"""The database: cameras, pose epochs, sightings, days, calibrations, refits and events, in SQLite or PostgreSQL.

`archive` the class `Archive`, made of `sightings calibrations calibration_states calibration_inputs days_and_events
epoch_closing sighting_revisions file_sightings outbox feeds fleet notices night_images nightly counts housekeeping
condition_times` · `values feed_values cross_check housekeeping_values` its values · `tables types` the schema ·
`engine server store` connections and transactions · `schema migrating` revisions · `outbox feeds feed_rows` what is
sent to a hub · `backup recovery file lock ownership space_reserve` the file on disk · `images` composites ·
`csv_files` sightings as CSV.
"""
