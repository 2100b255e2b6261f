-- Roles and database of a fleet's archive in PostgreSQL. Once, as the server's superuser:
--
--     sudo -u postgres psql -v ON_ERROR_STOP=1 -f roles.sql
--
-- then `sunarc db upgrade` as sunarc_owner, then grants.sql. Roles have no password: they log in by peer
-- authentication (pg_ident.conf maps users of the host), or get one by \password.

CREATE ROLE sunarc_owner LOGIN;  -- owns and migrates the tables, gives tokens; requests are never served as this one
CREATE ROLE sunarc_feed LOGIN;   -- the hub's service: reads, and writes what imagers send
CREATE ROLE sunarc_reader LOGIN; -- reads: reports, notebooks

CREATE DATABASE sunarc OWNER sunarc_owner TEMPLATE template0 ENCODING 'UTF8' LC_COLLATE 'C' LC_CTYPE 'C';
REVOKE ALL ON DATABASE sunarc FROM PUBLIC;
GRANT CONNECT ON DATABASE sunarc TO sunarc_feed, sunarc_reader;

\connect sunarc
ALTER SCHEMA public OWNER TO sunarc_owner;
REVOKE ALL ON SCHEMA public FROM PUBLIC;
GRANT USAGE ON SCHEMA public TO sunarc_feed, sunarc_reader;
