-- What the roles of roles.sql may do. As the owner, after every `sunarc db upgrade`: a new table is open to nobody else.
--
--     psql -v ON_ERROR_STOP=1 -d sunarc -U sunarc_owner -f grants.sql

GRANT SELECT ON ALL TABLES IN SCHEMA public TO sunarc_reader, sunarc_feed;
GRANT INSERT, UPDATE ON
    camera, pose_epoch, sun_point, day, day_air, calibration, used_sightings, refit, event
    TO sunarc_feed;
GRANT DELETE ON day_air TO sunarc_feed; -- a day's measured air can be taken back
GRANT USAGE ON ALL SEQUENCES IN SCHEMA public TO sunarc_feed;
GRANT EXECUTE ON FUNCTION sunarc_require_month(bigint) TO sunarc_feed; -- makes the partition of a month, as its owner
