"""PostgreSQL as the store: partitions, locks, the data version, roles, restarts and failovers."""

from __future__ import annotations

import json
import random
import threading
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from sqlalchemy import URL, Engine, event, text
from tests.fixtures.feed_cases import good_rows
from tests.fixtures.fleet import NOW, batch_of, feed, new_imager, sighting
from tests.fixtures.postgresql import TEMPLATE, Server, running_server
from tests.fixtures.stores import NOON, ROOF
from tests.imager.archive.test_calibrations import document

from sunarc.common.errors import InputError, OutsideError, SchemaError, StoreFullError
from sunarc.common.findings import uncoded
from sunarc.hub.archive import HubArchive, open_hub_archive
from sunarc.hub.feeds import KEPT
from sunarc.imager.archive.database.connections import create_server_engine, server_url, writing
from sunarc.imager.archive.database.schema import check, head_revision, upgrade_server
from sunarc.imager.archive.database.tables import metadata
from sunarc.imager.archive.feed_rows import REMOVED, FeedBatch
from sunarc.imager.archive.sightings import MOVED
from sunarc.imager.archive.values import SunPoint, field_values

DEPLOY = Path(__file__).parents[3] / "deploy" / "hub"
POINT = SunPoint(
    camera="roof", pose_epoch="roof-1", time=NOON, method="disc", accepted=True, verdict="clear", x_px=1.0, y_px=2.0
)


@pytest.fixture
def url(postgresql: Server) -> URL:
    return postgresql.emptied_database()


@pytest.fixture
def engine_of(url: URL) -> Iterator[Engine]:
    engine = create_server_engine(url)
    yield engine
    engine.dispose()


def opened(url: URL) -> HubArchive:
    archive = open_hub_archive(url)
    archive.cameras.save(ROOF)
    archive.epochs.at("roof", datetime(2013, 1, 1, tzinfo=UTC), reason="installed")
    return archive


def test_the_migrations_make_the_tables_of_the_models(engine_of: Engine) -> None:
    def is_declared(_object: object, name: str | None, kind: str, reflected: bool, other: object) -> bool:  # noqa: FBT001 - alembic's
        # the partitions and their index exist on this engine alone
        return not (reflected and other is None and (kind == "index" or str(name).startswith("sun_point_")))

    with engine_of.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True, "include_object": is_declared})
        assert compare_metadata(context, metadata) == []


def test_sightings_go_to_the_partition_of_their_month_and_a_query_reads_no_other(url: URL, engine_of: Engine) -> None:
    ends = [datetime(2013, 4, 30, 23, 59, 59, 999_999, UTC), datetime(2013, 5, 1, tzinfo=UTC)]
    with opened(url) as archive:
        assert archive.sightings.add(replace(POINT, time=time) for time in ends) == 2
        assert [p.time for p in archive.sightings.find("roof")] == ends
    with engine_of.connect() as connection:
        month = "SELECT time FROM sun_point_{} ORDER BY time"
        found = [connection.execute(text(month.format(name))).scalars().all() for name in ("201304", "201305")]
        assert [len(times) for times in found] == [1, 1]
        since = 1_367_366_400_000_000  # 2013-05-01
        asked = f"FROM sun_point WHERE camera = 'roof' AND time >= {since} AND time < {since + 10**9}"
        plan = "\n".join(connection.execute(text(f"EXPLAIN SELECT * {asked}")).scalars())
        assert "sun_point_201305" in plan
        assert "sun_point_201304" not in plan
        kinds = "SELECT indexdef FROM pg_indexes WHERE tablename = 'sun_point_201305'"
        assert any("USING brin" in line for line in connection.execute(text(kinds)).scalars())


def test_plans_of_the_archives_own_questions_use_one_partition_and_its_indices(url: URL, engine_of: Engine) -> None:
    begin = datetime(2013, 4, 1, tzinfo=UTC)
    statements: list[tuple[str, Any]] = []
    with opened(url) as archive:
        archive.sightings.add(replace(POINT, time=begin + timedelta(minutes=30 * n)) for n in range(4000))
        event.listen(
            archive.database.engine, "before_cursor_execute", lambda *call: statements.append((call[2], call[3]))
        )
        since = datetime(2013, 5, 8, tzinfo=UTC)
        archive.sightings.columns("roof", since=since, until=since + timedelta(days=2))
        archive.sightings.exposure_times("roof", since=since, until=since + timedelta(days=2))
    with engine_of.execution_options(isolation_level="AUTOCOMMIT").connect() as connection:
        connection.exec_driver_sql("VACUUM ANALYZE sun_point")
        asked = [one for one in statements if "FROM sun_point" in one[0]]
        assert len(asked) >= 2
        for statement, values in asked:
            plan = "\n".join(connection.exec_driver_sql(f"EXPLAIN {statement}", values).scalars())
            assert "sun_point_201305" in plan
            assert "sun_point_201304" not in plan
            assert "sun_point_201306" not in plan
            assert "Index" in plan
            assert "Seq Scan on sun_point" not in plan


def test_an_hour_of_all_cameras_is_found_by_brin_where_rows_came_in_the_order_of_time(
    url: URL, engine_of: Engine
) -> None:
    begin, end = (int(datetime(2013, 5, day, tzinfo=UTC).timestamp() * 1e6) for day in (1, 31))
    with opened(url) as archive:
        archive.sightings.add([POINT])
    columns = "camera, pose_epoch, time, body, exposure_us, method, accepted, verdict, reason"
    values = (
        f"'roof', 'roof-1', t, 'sun', 47, 'disc', true, 'clear', '' FROM generate_series({begin}, {end}, 60000000) t"
    )
    with engine_of.execution_options(isolation_level="AUTOCOMMIT").connect() as connection:
        connection.exec_driver_sql(f"INSERT INTO sun_point ({columns}) SELECT {values}")
        connection.exec_driver_sql("VACUUM ANALYZE sun_point")
        first = begin + 10 * 86_400_000_000
        hour = f"FROM sun_point WHERE time >= {first} AND time < {first + 3_600_000_000}"
        plan = "\n".join(connection.exec_driver_sql(f"EXPLAIN SELECT * {hour}").scalars())
    assert "Bitmap Index Scan on sun_point_201305_time_idx" in plan


@pytest.mark.parametrize("year", [1969, 2200])
def test_a_time_that_no_sighting_has_makes_no_partition(url: URL, year: int) -> None:
    with opened(url) as archive:
        with pytest.raises(InputError):
            archive.sightings.add([replace(POINT, time=datetime(year, 6, 1, tzinfo=UTC))])
        assert archive.sightings.find("roof") == ()


def test_a_second_upgrade_finds_nothing_to_do_and_a_check_tells_rows(url: URL) -> None:
    assert not upgrade_server(url)
    opened(url).close()
    found = check(url)
    assert found.sound
    assert (found.revision, found.rows["camera"], found.rows["sun_point"]) == (head_revision(), 1, 0)


def test_a_database_without_tables_or_of_a_newer_version_is_refused(postgresql: Server) -> None:
    empty = postgresql.new_database(template="template0")
    with pytest.raises(SchemaError, match="upgrade --store"):
        open_hub_archive(empty)
    assert upgrade_server(empty)
    open_hub_archive(empty).close()
    postgresql.sql(str(empty.database), "UPDATE alembic_version SET version_num = '9999'")
    for attempt in (open_hub_archive, upgrade_server):
        with pytest.raises(SchemaError, match="9999"):
            attempt(empty)
    postgresql.drop(empty)


def test_the_revision_changes_with_every_commit_of_anyone_and_else_not(url: URL) -> None:
    with opened(url) as archive, open_hub_archive(url) as other:
        before = archive.revision()
        assert archive.revision() == before
        archive.sightings.find("roof")
        assert archive.revision() == before
        other.sightings.add([POINT])
        after = archive.revision()
        assert after != before
        assert archive.revision() == after


@pytest.mark.parametrize(
    ("first", "second", "waits"),
    [("roof", "mast", False), ("roof", "roof", True), (None, "roof", True), ("roof", None, True), (None, None, True)],
)
def test_writers_of_different_cameras_do_not_wait_for_one_another(
    engine_of: Engine, first: str | None, second: str | None, *, waits: bool
) -> None:
    begun = threading.Event()

    def write() -> None:
        with writing(engine_of, camera=second):
            begun.set()

    with writing(engine_of, camera=first):
        thread = threading.Thread(target=write)
        thread.start()
        assert begun.wait(0.3 if waits else 10.0) is not waits
    thread.join(10.0)
    assert begun.is_set()


def test_a_restart_of_the_server_breaks_no_more_than_what_is_under_way(url: URL, postgresql: Server) -> None:
    with opened(url) as archive:
        before = archive.revision()
        postgresql.stop()
        with pytest.raises(OutsideError):
            archive.sightings.add([POINT])
        with pytest.raises(OutsideError):
            archive.revision()
        postgresql.start()
        assert archive.sightings.add([POINT]) == 1
        assert archive.revision() != before
        assert len(archive.sightings.find("roof")) == 1


def test_after_a_failover_the_new_server_is_written_to(url: URL, postgresql: Server) -> None:
    with running_server() as first:
        first.sql(TEMPLATE, "SELECT 1")
        with running_server(copy_of=first) as standby:
            hosts = {"host": f"{first.folder},{standby.folder}", "target_session_attrs": "read-write"}
            with opened(url.update_query_dict(hosts)) as archive:
                archive.sightings.add([POINT])
                first.sql("postgres", "SELECT pg_switch_wal()")
                _wait_for_row(standby)
                with pytest.raises(OutsideError):
                    open_hub_archive(standby.url(TEMPLATE))  # a stand-by alone is none to write to
                first.stop()
                standby.promote()
                assert archive.sightings.add([POINT, replace(POINT, time=NOON + timedelta(seconds=30))]) == 1
                assert len(archive.sightings.find("roof")) == 2
            first.start()
    assert postgresql.folder != first.folder


def _wait_for_row(server: Server) -> None:
    ticking = threading.Event()
    for _ in range(100):
        if server.sql(TEMPLATE, "SELECT count(*) FROM sun_point").strip() == "1":
            return
        ticking.wait(0.1)
    pytest.fail("the stand-by did not follow")


@pytest.mark.parametrize(
    "store", ["", "sqlite:///x", "mysql://h/d", "postgresql+psycopg://host", "postgresql+asyncpg://h/d", "no address"]
)
def test_another_address_is_no_store(store: str) -> None:
    with pytest.raises(InputError) as error:
        server_url(store)
    assert error.value.field == "store"


def test_a_password_is_in_no_message() -> None:
    url = server_url("postgresql://someone:hidden-word@127.0.0.1:1/sunarc")
    with pytest.raises(OutsideError) as error:
        open_hub_archive(url)
    assert "hidden-word" not in str(error.value)
    assert "someone" in str(error.value)


@pytest.fixture(scope="module")
def fleet() -> Iterator[Server]:
    """Yield a server with the roles and the database of deploy/hub."""
    with running_server() as server:
        for name, user in (("roles.sql", "test"), (None, "sunarc_owner"), ("grants.sql", "sunarc_owner")):
            if name is None:
                upgrade_server(server.url("sunarc", user=user))
                continue
            database = "postgres" if user == "test" else "sunarc"
            script = server.folder / name
            script.write_text((DEPLOY / name).read_text())
            server.run(
                "psql", "-qX", "-v", "ON_ERROR_STOP=1", "-h", server.folder, "-U", user, "-d", database, "-f", script
            )
        yield server


def test_the_feeds_role_stores_what_imagers_send_and_changes_no_table(fleet: Server) -> None:
    with opened(fleet.url("sunarc", user="sunarc_feed")) as archive:
        assert archive.sightings.add([POINT]) == 1  # makes a partition
    refused = ["DROP TABLE sun_point", "DELETE FROM calibration", "DELETE FROM event", "CREATE TABLE mine (x int)"]
    refused += ["UPDATE feed_token SET expires_at = NULL", "INSERT INTO feed_token VALUES ('d', 'roof', 0, NULL)"]
    for statement in refused:
        with pytest.raises(AssertionError, match=r"denied|owner"):
            fleet.sql("sunarc", statement, user="sunarc_feed")


def test_each_table_whose_rows_the_role_may_not_store_is_named(fleet: Server) -> None:
    with open_hub_archive(fleet.url("sunarc", user="sunarc_feed")) as archive:
        archive.feeds.require_storing()
        month = "sunarc_require_month(bigint)"
        for what, privilege, named in (
            ("sun_point", "INSERT", "sun_point"),
            ("day, refit", "UPDATE", "day, refit"),
            ("feed", "SELECT", "feed"),
            (f"FUNCTION {month}", "EXECUTE", "new months"),
        ):
            fleet.sql("sunarc", f"REVOKE {privilege} ON {what} FROM sunarc_feed", user="sunarc_owner")
            with pytest.raises(OutsideError, match=f"rows of {named} cannot"):
                archive.feeds.require_storing()
            fleet.sql("sunarc", f"GRANT {privilege} ON {what} TO sunarc_feed", user="sunarc_owner")
        archive.feeds.require_storing()


def test_the_readers_role_reads_and_writes_nothing(fleet: Server) -> None:
    with open_hub_archive(fleet.url("sunarc", user="sunarc_reader")) as archive:
        archive.sightings.find("roof")
        with pytest.raises(OutsideError, match="permission denied"):
            archive.cameras.save(ROOF)
    for statement in ("SELECT sunarc_require_month(0)", "SELECT digest FROM feed_token"):
        with pytest.raises(AssertionError, match="permission denied"):
            fleet.sql("sunarc", statement, user="sunarc_reader")


def test_a_feed_is_stored_by_the_feeds_role(fleet: Server, tmp_path: Path) -> None:
    with new_imager(tmp_path, "mast") as imager, open_hub_archive(fleet.url("sunarc", user="sunarc_feed")) as hub:
        imager.sightings.add([sighting(0, camera="mast")])
        feed(imager, hub, "mast")
        assert hub.sightings.find("mast") == imager.sightings.find("mast")
        assert "mast" in [camera.camera for camera in hub.feeds.fleet()]


def test_every_kind_of_row_is_stored_and_aged_by_the_feeds_role(fleet: Server, tmp_path: Path) -> None:
    rows = good_rows(tmp_path, "pole")
    whole = [row for row in rows if not row[0].endswith(REMOVED)]
    with open_hub_archive(fleet.url("sunarc", user="sunarc_feed")) as hub:
        assert hub.feeds.take(batch_of(*whole, camera="pole"), now=NOW) == len(whole)
        assert hub.feeds.quarantine("pole") == ()
        assert (len(hub.nights.find("pole")), len(hub.events.find("pole"))) == (1, 1)
        removed = [row for row in rows if row[0].endswith(REMOVED)]
        hub.feeds.take(batch_of(*removed, camera="pole", after=len(whole)), now=NOW)
        assert {one.kind for one in hub.feeds.quarantine("pole")} == {
            f"{kind}{REMOVED}" for kind in ("camera", "pose_epoch", "day", "calibration", "refit", "event", "night")
        }
        assert hub.feeds.expire(now=NOW + 2 * KEPT) >= 7


def batch_after(imager: HubArchive, *rows: tuple[str, dict[str, Any]], camera: str) -> FeedBatch:
    """Return rows made by hand as an imager's next batch."""
    position = imager.outbox.position()
    made = batch_of(*rows, camera=camera, after=position.committed)
    return replace(made, installation=position.installation)


def row_of(number: int, camera: str, **changes: Any) -> dict[str, Any]:  # noqa: ANN401 - of many types
    row = field_values(sighting(number, camera=camera))
    row["reason"] = json.dumps([one.as_json() for one in row.pop("findings")])
    return row | {"time": int(row["time"].timestamp() * 1e6)} | changes


def test_sentences_of_sightings_become_findings_in_the_partitions(url: URL) -> None:
    upgrade_server(url)
    with opened(url) as archive:
        archive.sightings.add([POINT, replace(POINT, time=NOON + timedelta(days=40))])
        with writing(archive.database.engine) as connection:
            connection.execute(text("UPDATE sun_point SET reason = 'the camera had moved' WHERE id = 1"))
            connection.execute(text("UPDATE sun_point SET reason = 'of another version' WHERE id > 1"))
            connection.execute(text("DROP TABLE seen_file"))
            connection.execute(text("ALTER TABLE sun_point DROP CONSTRAINT uq_sun_point, DROP COLUMN folder"))
            key = "camera, time, body, exposure_us, method, file"
            connection.execute(text(f"ALTER TABLE sun_point ADD CONSTRAINT uq_sun_point UNIQUE ({key})"))
            connection.execute(text("UPDATE alembic_version SET version_num = '0017'"))
    assert upgrade_server(url)
    with open_hub_archive(url) as archive:
        assert [one.findings for one in archive.sightings.find("roof")] == [MOVED, (uncoded("of another version"),)]


def test_what_the_feeds_role_may_not_do_is_set_apart_and_the_rest_is_stored(fleet: Server, tmp_path: Path) -> None:
    with new_imager(tmp_path, "yard") as imager, open_hub_archive(fleet.url("sunarc", user="sunarc_feed")) as hub:
        imager.calibrations.add(document("yard-a", camera="yard", pose_epoch="yard-1"))
        feed(imager, hub, "yard")
        long_name = random.Random(1).randbytes(9000).hex()  # longer than an entry of an index may be
        batch = batch_after(
            imager,
            ("sun_point", row_of(1, "yard")),
            ("calibration.removed", {"id": "yard-a"}),
            ("pose_epoch.removed", {"id": "yard-1"}),
            ("sun_point", row_of(2, "yard", file=long_name)),
            ("sun_point", row_of(3, "yard")),
            camera="yard",
        )
        assert hub.feeds.take(batch, now=NOW) == batch.rows[-1].seq
        found = sorted(hub.feeds.quarantine("yard"), key=lambda one: one.seq)
        assert [(one.kind, one.reason) for one in found] == [
            ("calibration.removed", "refused_by_database"),
            ("pose_epoch.removed", "refused_by_database"),
            ("sun_point", "refused_by_database"),
        ]
        assert ["permission denied" in one.text for one in found] == [True, True, False]
        assert len(hub.sightings.find("yard")) == 2
        assert [one.id for one in hub.calibrations.find("yard")] == ["yard-a"]


def test_one_camera_removes_no_calibration_of_another_by_the_owners_role(fleet: Server, tmp_path: Path) -> None:
    with (
        new_imager(tmp_path, "gate") as imager,
        new_imager(tmp_path, "hill") as other,
        open_hub_archive(fleet.url("sunarc", user="sunarc_owner")) as hub,
    ):
        for one, name in ((imager, "gate"), (other, "hill")):
            one.calibrations.add(document(f"{name}-a", camera=name, pose_epoch=f"{name}-1"))
            one.calibrations.activate(f"{name}-a")
            feed(one, hub, name)
        removals = [("calibration.removed", {"id": target}) for target in ("gate-a", "hill-a")]
        batch = batch_after(other, *removals, camera="hill")
        assert hub.feeds.take(batch, now=NOW) == batch.rows[-1].seq
        current = hub.calibrations.current("gate")
        assert current is not None
        assert current.id == "gate-a"
        assert hub.calibrations.find("hill") == ()  # its own is removed
        assert [one.reason for one in hub.feeds.quarantine("hill")] == ["contradiction"]


@pytest.mark.parametrize(
    ("code", "is_of_row"),
    [
        ("P0001", True),  # raise_exception
        ("42501", True),  # insufficient_privilege
        ("22003", True),  # numeric_value_out_of_range
        ("23514", True),  # check_violation
        ("54000", True),  # program_limit_exceeded
        ("53100", False),  # disk_full
        ("53200", False),  # out_of_memory
        ("40001", False),  # serialization_failure
        ("40P01", False),  # deadlock_detected
        ("55P03", False),  # lock_not_available
        ("57014", False),  # query_canceled
        ("25006", False),  # read_only_sql_transaction
        ("58030", False),  # io_error
        ("XX001", False),  # data_corrupted
    ],
)
def test_an_error_of_a_row_is_set_apart_and_one_of_the_server_is_none(
    url: URL, postgresql: Server, tmp_path: Path, code: str, *, is_of_row: bool
) -> None:
    """A trigger refuses one sighting with a code of PostgreSQL."""
    body = f"BEGIN IF NEW.x_px = 77 THEN RAISE EXCEPTION 'it is so' USING ERRCODE = '{code}'; END IF; RETURN NEW; END"
    make = f"CREATE OR REPLACE FUNCTION refuse() RETURNS trigger LANGUAGE plpgsql AS $${body}$$"
    attach = "CREATE TRIGGER refuse BEFORE INSERT ON sun_point FOR EACH ROW EXECUTE FUNCTION refuse()"
    with new_imager(tmp_path, "roof") as imager, open_hub_archive(url) as hub:
        feed(imager, hub)
        postgresql.sql(TEMPLATE, make, attach)
        rows = [("sun_point", row_of(n, "roof", x_px=77.0 if n == 1 else 1.0)) for n in range(3)]
        batch = batch_after(imager, *rows, camera="roof")
        try:
            if is_of_row:
                assert hub.feeds.take(batch, now=NOW) == batch.rows[-1].seq
                assert len(hub.sightings.find("roof")) == 2
                assert [(one.seq, one.data != "") for one in hub.feeds.quarantine()] == [(batch.rows[1].seq, True)]
                return
            with pytest.raises(OutsideError) as error:
                hub.feeds.take(batch, now=NOW)
            assert isinstance(error.value, StoreFullError) == (code == "53100")
            assert hub.sightings.find("roof") == ()
        finally:
            postgresql.sql(TEMPLATE, "DROP TRIGGER refuse ON sun_point", "DROP FUNCTION refuse()")
        assert hub.feeds.take(batch, now=NOW) == batch.rows[-1].seq  # all of it waited
        assert len(hub.sightings.find("roof")) == 3
        assert hub.feeds.quarantine() == ()


def test_a_copy_is_restored_into_a_new_database_and_imagers_go_on(fleet: Server, tmp_path: Path) -> None:
    folder = fleet.folder / "copies"
    owner = fleet.url("sunarc", user="sunarc_owner")
    with new_imager(tmp_path, "attic") as imager:
        imager.sightings.add(sighting(n, camera="attic") for n in range(5))
        with open_hub_archive(owner) as hub:
            feed(imager, hub, "attic")
        options = ("-h", str(fleet.folder), "-U", "sunarc_owner")
        names = [fleet.carry_out(DEPLOY / "backup", str(folder), "1", *options).strip() for _ in range(2)]
        assert Path(names[-1]).exists()
        assert len(list(folder.iterdir())) == 1
        fleet.sql("postgres", "CREATE DATABASE again OWNER sunarc_owner TEMPLATE template0")
        fleet.carry_out(DEPLOY / "restore", names[-1], "again", *options)
        with open_hub_archive(fleet.url("again", user="sunarc_owner")) as hub:
            assert hub.sightings.find("attic") == imager.sightings.find("attic")
            imager.sightings.add(sighting(n, camera="attic") for n in range(5, 9))
            feed(imager, hub, "attic")
            assert hub.sightings.find("attic") == imager.sightings.find("attic")
        assert check(fleet.url("again", user="sunarc_owner")).sound
