"""Query plans and times of a store with many sightings: tests/long fleet-scale [--rows N] [--cameras N]."""

from __future__ import annotations

import argparse
import json
import shutil
import statistics
import tempfile
import urllib.request
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import psycopg
from tests.fixtures.calibrations import chosen_calibration
from tests.fixtures.hub_process import HubProcess
from tests.fixtures.postgresql import TEMPLATE, Server, running_server
from tests.fixtures.served import LENS

from sunarc.formats.calibration_document import to_document
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.values import CameraRecord

_BEGIN = datetime(2026, 1, 1, tzinfo=UTC)
_STEP_S = 30.0
_FILL = """
INSERT INTO sun_point (camera, pose_epoch, time, body, exposure_us, method, accepted, verdict, reason, x_px, y_px,
    sigma_px, peak_fraction, background_fraction, radius_px, ellipticity, residual_chi2, snr, saturated_px,
    clock_error_s)
SELECT camera, camera || '-1', %(begin)s + n * %(step)s, 'sun', 47.0, 'disc', n %% 5 <> 0, 'clear',
    'the disc fits', 871.0 + sin(n), 883.0 + cos(n), 0.03, 0.6, 0.03, 3.1, 0.04, 1.1, 310.0, 0, 0.01
FROM generate_series(%(first)s::bigint, %(last)s) n, (SELECT calibration.camera FROM calibration) cameras ORDER BY n
"""
_AT_ONCE = 20_000
_ACCEPTED = (
    "EXPLAIN (ANALYZE, COSTS OFF, TIMING OFF) SELECT time, x_px, y_px FROM sun_point WHERE camera = 'c000' "
    "AND accepted AND time >= {0} AND time < {1} ORDER BY time, id"
)
_ALL_CAMERAS = (
    "EXPLAIN (ANALYZE, COSTS OFF, TIMING OFF) SELECT count(*) FROM sun_point WHERE time >= {0} AND time < {1}"
)


def fill(server: Server, *, rows: int, cameras: int, listed: int) -> float:
    """Fill the store, and return how long it took: `rows` sightings of `cameras`, and `listed` cameras in all."""
    begun_s = perf_counter()
    each = rows // cameras
    solved = chosen_calibration(LENS, names=("rotation_x",), covariance=np.eye(1) * 1e-10, orders=np.array([[1, 1]]))
    with open_archive(server.url(TEMPLATE)) as archive:
        archive.database.prepare_months(
            [_BEGIN + timedelta(days=31 * n) for n in range(int(each * _STEP_S / 86_400 / 28) + 2)]
        )
        for n in range(listed):
            name = f"c{n:03d}"
            archive.cameras.save(
                CameraRecord(name=name, latitude=36.6, longitude=-97.5 + n / 100, altitude=0.0, width=8, height=6)
            )
            if n < cameras:
                archive.epochs.at(name, _BEGIN, reason="installed")
                document = to_document(
                    solved,
                    id=f"{name}-a",
                    camera=name,
                    state="candidate",
                    created_at=_BEGIN,
                    valid_from=_BEGIN,
                    valid_until=None,
                    pose_epoch=f"{name}-1",
                    software_version="1",
                )
                archive.calibrations.add(document)
                archive.calibrations.activate(f"{name}-a")
    with psycopg.connect(host=str(server.folder), user="test", dbname=TEMPLATE, autocommit=True) as connection:
        given = {"begin": int(_BEGIN.timestamp() * 1e6), "step": int(_STEP_S * 1e6)}
        for first in range(0, each, _AT_ONCE):  # in the order of time, as sightings arrive
            connection.execute(_FILL, given | {"first": first, "last": min(first + _AT_ONCE, each) - 1})
        status = json.dumps({"health": "ready", "disk_free_bytes": 10**10})
        connection.execute(
            "INSERT INTO fleet (camera, received_at, last_sighting_at, calibration, sky_rms_deg, status) "
            "SELECT name, 1, 1, name || '-a', 0.01, %s FROM camera",
            (status,),
        )
        connection.execute("VACUUM ANALYZE")
    return perf_counter() - begun_s


def plans(server: Server, *, each: int) -> dict[str, list[str]]:
    """Return the plans of a week of one camera, and of an hour of all."""
    day_us = 86_400_000_000
    since = int(_BEGIN.timestamp() * 1e6) + int(each * _STEP_S * 1e6) // 2
    asked = {"a week of one camera": _ACCEPTED.format(since, since + 7 * day_us)}
    asked["an hour of all cameras"] = _ALL_CAMERAS.format(since, since + day_us // 24)
    with psycopg.connect(host=str(server.folder), user="test", dbname=TEMPLATE) as connection:
        return {what: [row[0] for row in connection.execute(sql).fetchall()] for what, sql in asked.items()}


def median_ms(ask: Callable[[], Any], *, times: int = 50) -> float:
    """Return the median time of a question after a first one, ms."""
    ask()
    spent = []
    for _ in range(times):
        begun_s = perf_counter()
        ask()
        spent.append(1e3 * (perf_counter() - begun_s))
    return round(statistics.median(spent), 2)


def times(server: Server, hub: HubProcess, *, each: int) -> dict[str, float]:
    """Return the median times of questions over HTTP and to the archive, ms."""
    base = hub.url

    def of(path: str) -> Callable[[], Any]:
        return lambda: urllib.request.urlopen(base + path, timeout=60).read()

    with open_archive(server.url(TEMPLATE)) as archive:
        since = _BEGIN + timedelta(seconds=each * _STEP_S / 2)
        return {
            "/v1/cameras/c000/calibration": median_ms(of("/v1/cameras/c000/calibration")),
            "/v1/fleet": median_ms(of("/v1/fleet"), times=20),
            "/v1/cameras/c000/sun-points?limit=100": median_ms(of("/v1/cameras/c000/sun-points?limit=100"), times=20),
            "columns of a week": median_ms(
                lambda: archive.sightings.columns("c000", since=since, until=since + timedelta(days=7)), times=5
            ),
        }


def main() -> None:
    """Fill a store, ask, and print what was measured, as JSON."""
    parser = argparse.ArgumentParser(prog="tests/long fleet-scale", description=__doc__)
    parser.add_argument("--rows", type=int, default=10_000_000)
    parser.add_argument("--cameras", type=int, default=50, help="with sightings and a calibration")
    parser.add_argument("--listed", type=int, default=1000, help="cameras in all")
    asked = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="scale"))
    each = asked.rows // asked.cameras
    with running_server() as server:
        filled_s = fill(server, rows=asked.rows, cameras=asked.cameras, listed=asked.listed)
        size = server.sql(TEMPLATE, f"SELECT pg_size_pretty(pg_database_size('{TEMPLATE}'))").strip()
        hub = HubProcess(folder, server.url(TEMPLATE))
        try:
            hub.wait_until_it_answers()
            found = {"rows": asked.rows, "filled_s": round(filled_s), "size": size, "ms": times(server, hub, each=each)}
        finally:
            hub.kill()
        print(json.dumps(found | {"plans": plans(server, each=each)}, indent=1))
    shutil.rmtree(folder)


if __name__ == "__main__":
    main()
