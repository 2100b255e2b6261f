-- What the roles of roles.sql may do. As the owner, after every `sunarc db upgrade`: no other role may use a new table.
--
--     psql -v ON_ERROR_STOP=1 -d sunarc -U sunarc_owner -f grants.sql

GRANT SELECT ON ALL TABLES IN SCHEMA public TO sunarc_reader, sunarc_feed;
REVOKE ALL ON feed_token FROM sunarc_reader; -- digests of tokens
GRANT INSERT, UPDATE ON
    camera, pose_epoch, sun_point, day, day_air, calibration, used_sightings, refit, event, night, feed, fleet, quarantine,
    notice, notice_position, notice_sink, day_summary, nightly_run, housekeeping, condition
    TO sunarc_feed;
GRANT DELETE ON day_air, sun_point TO sunarc_feed; -- air that is taken back, a sighting whose file gets its name
GRANT DELETE ON quarantine TO sunarc_feed; -- what did not come again for 90 days
GRANT DELETE ON housekeeping, condition TO sunarc_feed; -- hours that are too old, conditions that have ended
GRANT DELETE ON notice, notice_position, notice_sink TO sunarc_feed; -- what every receiver has
GRANT USAGE ON ALL SEQUENCES IN SCHEMA public TO sunarc_feed;
GRANT EXECUTE ON FUNCTION sunarc_require_month(bigint) TO sunarc_feed; -- makes the partition of a month, as its owner
GRANT EXECUTE ON FUNCTION sunarc_drop_months(bigint) TO sunarc_feed; -- drops partitions of 90 days and older, as its owner
