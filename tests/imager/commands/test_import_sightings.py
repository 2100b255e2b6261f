"""A file of sightings goes into the archive as it is, or not at all; and comes back the same."""

from __future__ import annotations

import io
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.settings import new_settings

from sunarc.common.errors import InputError
from sunarc.formats.csv_files import read_sightings
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.commands.archive_tables import import_points, write_points
from sunarc.sky.directions import angles_from_direction
from sunarc.sky.night import body_directions

HEADER = "time_utc,x_px,y_px,sigma_px,temperature_c,pressure_hpa,clock_error_s"
ROWS = ("2013-05-13T18:30:00Z,3.25,2.5,0.04,21.5,980.25,0.5", "2013-05-13T18:31:00Z,3.5,2.75,,,,")


def points_file(folder: Path, *rows: str) -> Path:
    path = folder / "points.csv"
    path.write_text("\n".join([HEADER, *(rows or ROWS), ""]))
    return path


def test_every_column_reaches_the_archive(tmp_path: Path) -> None:
    settings = new_settings(tmp_path)
    assert import_points(settings, points_file(tmp_path), image_size=(8, 6)) == (2, 2, 0)
    with open_archive(settings.database) as archive:
        first, second = archive.sightings.find("roof")
    assert first.time == datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
    assert (first.x_px, first.y_px, first.sigma_px) == (3.25, 2.5, 0.04)
    assert (first.temperature_c, first.pressure_hpa) == (21.5, 980.25)
    assert first.clock_error_s == 0.5
    assert (first.method, first.accepted) == ("import", True)
    assert (second.sigma_px, second.temperature_c, second.pressure_hpa) == (None, None, None)
    assert second.clock_error_s is None


def test_what_is_there_already_is_not_added_again(tmp_path: Path) -> None:
    settings = new_settings(tmp_path)
    import_points(settings, points_file(tmp_path), image_size=(8, 6))
    more = points_file(tmp_path, *ROWS, "2013-05-13T18:32:00Z,3.5,2.75,,,,")
    assert import_points(settings, more) == (1, 3, 0)


def test_a_row_beside_the_image_is_left_out_and_counted(tmp_path: Path) -> None:
    settings = new_settings(tmp_path)
    beside = points_file(tmp_path, *ROWS, "2013-05-13T18:32:00Z,7.54,2.0,,,,")
    assert import_points(settings, beside, image_size=(8, 6)) == (2, 3, 1)
    with open_archive(settings.database) as archive:
        assert len(archive.sightings.find("roof")) == 2


@pytest.mark.parametrize("row", ["2013-05-13T18:32:00Z,9.0,2.0,,,,", "2013-05-13T18:32:00Z,1.0,two,,,", "noon,1,1,,,,"])
def test_one_wrong_row_and_nothing_is_written(tmp_path: Path, row: str) -> None:
    settings = new_settings(tmp_path)
    with pytest.raises(InputError):
        import_points(settings, points_file(tmp_path, *ROWS, row), image_size=(8, 6))
    assert not settings.database.exists()


def test_the_image_size_is_taken_from_the_region_of_the_settings(tmp_path: Path) -> None:
    settings = new_settings(tmp_path, camera={"address": "192.0.2.7", "region": (100, 200, 8, 6)})
    import_points(settings, points_file(tmp_path))
    with open_archive(settings.database) as archive:
        (camera,) = archive.cameras.all()
    assert (camera.width, camera.height) == (8, 6)


def test_the_archives_size_goes_before_the_region(tmp_path: Path) -> None:
    import_points(new_settings(tmp_path), points_file(tmp_path), image_size=(8, 6))
    settings = new_settings(tmp_path, camera={"address": "192.0.2.7", "region": (0, 0, 100, 100)})
    assert import_points(settings, points_file(tmp_path)) == (0, 2, 0)


def test_without_any_size_the_option_is_asked_for(tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        import_points(new_settings(tmp_path), points_file(tmp_path))
    assert refused.value.field == "--image-size"


def test_an_empty_database_file_is_not_asked_for_the_size(tmp_path: Path) -> None:
    settings = new_settings(tmp_path)
    settings.state.mkdir()
    settings.database.touch()
    with pytest.raises(InputError) as refused:
        import_points(settings, points_file(tmp_path))
    assert refused.value.field == "--image-size"


def test_what_is_written_is_what_was_read(tmp_path: Path) -> None:
    settings, target = new_settings(tmp_path), io.StringIO()
    import_points(settings, points_file(tmp_path), image_size=(8, 6))
    assert write_points(settings, target, since=None, until=None) == 2
    given = read_sightings(points_file(tmp_path).read_text().splitlines(), name="given")
    back = read_sightings(target.getvalue().splitlines(), name="back")
    for column in ("unix_s", "pixels", "sigma_px", "temperature", "pressure"):
        assert getattr(back, column) == pytest.approx(getattr(given, column), nan_ok=True), column


@pytest.mark.parametrize(
    ("since_min", "until_min", "count"), [(None, None, 2), (1, None, 1), (None, 1, 1), (0, 1, 1), (2, None, 0)]
)
def test_only_the_sightings_from_since_to_before_until_are_written(
    tmp_path: Path, since_min: int | None, until_min: int | None, count: int
) -> None:
    settings = new_settings(tmp_path)
    import_points(settings, points_file(tmp_path), image_size=(8, 6))
    first = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
    since, until = (None if m is None else first + timedelta(minutes=m) for m in (since_min, until_min))
    assert write_points(settings, io.StringIO(), since=since, until=until) == count


def stars_file(folder: Path, *, body: str = "star:HIP91262", zenith_deg: float | None = None) -> Path:
    settings = new_settings(folder)
    time = datetime(2013, 5, 13, 9, 0, tzinfo=UTC)
    direction = body_directions(np.array(["star:HIP91262"]), np.array([time.timestamp()]), settings.site)
    zenith, azimuth = (float(angle[0]) for angle in angles_from_direction(direction))
    path = folder / "stars.csv"
    path.write_text(
        "time_utc,x_px,y_px,sigma_px,body,zenith_deg,azimuth_deg\n"
        "2013-05-13T18:30:00Z,3.25,2.5,0.04,sun,,\n"
        f"2013-05-13T09:00:00Z,2.0,1.0,0.1,{body},{zenith_deg or zenith:.6f},{azimuth:.6f}\n"
    )
    return path


def test_stars_go_into_the_archive_and_come_back_with_their_directions(tmp_path: Path) -> None:
    settings, target = new_settings(tmp_path), io.StringIO()
    path = stars_file(tmp_path)
    assert import_points(settings, path, image_size=(8, 6)) == (2, 2, 0)
    with open_archive(settings.database) as archive:
        (star,) = archive.sightings.find("roof", body="star:HIP91262")
        assert len(archive.sightings.find("roof")) == 1
    assert (star.x_px, star.method) == (2.0, "import")
    write_points(settings, target, since=None, until=None)
    given = read_sightings(path.read_text().splitlines(), name="given")
    back = read_sightings(target.getvalue().splitlines(), name="back")
    assert back.body.tolist() == ["star:HIP91262", "sun"]
    assert back.directions[::-1] == pytest.approx(given.directions, nan_ok=True, abs=1e-7)


@pytest.mark.parametrize(
    ("body", "zenith_deg", "field"),
    [
        ("star:HIP91262", 20.0, "stars.csv, zenith_deg"),
        ("mast", None, "stars.csv, body"),
        ("sun", None, "stars.csv, body"),
    ],
)
def test_a_direction_that_is_no_body_s_is_refused(
    tmp_path: Path, body: str, zenith_deg: float | None, field: str
) -> None:
    path = stars_file(tmp_path, body=body, zenith_deg=zenith_deg)
    with pytest.raises(InputError) as refused:
        import_points(new_settings(tmp_path), path, image_size=(8, 6))
    assert refused.value.field == field
