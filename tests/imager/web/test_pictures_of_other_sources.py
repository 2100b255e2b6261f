"""`/v1/images` lists and serves the pictures of every source, and nothing that is no picture."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.fixtures.archive import new_archive
from tests.fixtures.served import NOON, Made, Make

from sunarc.common.utc import rfc3339
from sunarc.imager.archive.images import ImageStore
from sunarc.imager.archive.seen_files import SeenFile

TIMES = [NOON - timedelta(minutes=n) for n in range(4)]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for n, suffix in enumerate((".jpg", ".JPG", ".png", ".jpeg")):
        cv2.imwrite(str(tmp_path / f"ü{n}{suffix}"), np.full((40, 60, 3), 40 * n, np.uint8))
    return tmp_path


@pytest.fixture
def served(make: Make, folder: Path) -> Made:
    files = dict(zip(TIMES, sorted(folder.glob("ü*")), strict=True))

    def pictures(since: datetime | None, until: datetime | None, limit: int) -> list[tuple[datetime, Path]]:
        found = [(time, path) for time, path in files.items() if not since or time >= since]
        return [(time, path) for time, path in found if not until or time < until][:limit]

    return make(history="filled", pictures=pictures, images=ImageStore(folder / "images"))


def test_pictures_are_listed_with_their_format_in_pages(served: Made) -> None:
    first = served.client.get("/v1/images?limit=3").json()
    second = served.client.get(first["next"]).json()
    found = first["images"] + second["images"]
    assert [one["time"] for one in found] == [rfc3339(time) for time in TIMES]
    assert [one["format"] for one in found] == ["jpeg", "jpeg", "png", "jpeg"]
    assert [one["calibration"] for one in found] == ["second"] * 4
    assert all(one["bytes"] > 100 for one in found)
    assert second["next"] is None


def test_a_picture_is_served_as_it_is(served: Made, folder: Path) -> None:
    answer = served.client.get(f"/v1/images/{rfc3339(TIMES[1])}")
    assert (answer.headers["content-type"], answer.content) == ("image/jpeg", (folder / "ü1.JPG").read_bytes())
    assert served.client.get(f"/v1/images/{rfc3339(TIMES[2])}").headers["content-type"] == "image/png"
    tag = {"if-none-match": answer.headers["etag"]}
    assert served.client.get(f"/v1/images/{rfc3339(TIMES[1])}", headers=tag).status_code == 304
    small = served.client.get(f"/v1/images/{rfc3339(TIMES[2])}?width=20")
    decoded = cv2.imdecode(np.frombuffer(small.content, np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    assert decoded.shape[1] == 20


def test_a_format_that_a_picture_does_not_have_is_not_found(served: Made) -> None:
    assert served.client.get(f"/v1/images/{rfc3339(TIMES[0])}?format=png").status_code == 404
    assert served.client.get(f"/v1/images/{rfc3339(TIMES[2])}?format=jpeg").status_code == 404


def test_a_file_that_is_no_picture_any_more_is_not_sent(served: Made, folder: Path) -> None:
    secret = folder / "secret"
    secret.write_text("a token that is long enough")
    (folder / "ü0.jpg").unlink()
    (folder / "ü0.jpg").symlink_to(secret)
    answer = served.client.get(f"/v1/images/{rfc3339(TIMES[0])}")
    assert answer.status_code == 503
    assert "token" not in answer.text


def test_pictures_that_a_camera_s_program_let_keep_are_listed_beside_its_last_one(make: Make, tmp_path: Path) -> None:
    store = ImageStore(tmp_path / "images", free_bytes=lambda _: 10**12)
    encoded = cv2.imencode(".jpg", np.zeros((4, 6, 3), np.uint8))[1].tobytes()
    kept = [store.write(time, encoded, kind="hdr.jpg") for time in TIMES[1:]]
    made = make(history="filled", images=store, pictures=lambda *_: [(TIMES[0], kept[0])])
    listed = made.client.get("/v1/images").json()["images"]
    assert [(one["time"], one["format"]) for one in listed] == [(rfc3339(time), "jpeg") for time in TIMES]


def test_files_that_were_used_are_found_by_their_images_times(tmp_path: Path) -> None:
    archive = new_archive(tmp_path)
    files = [SeenFile(camera="roof", file=f"{n}.jpg", stamp="1", time=time) for n, time in enumerate(TIMES)]
    left_out = SeenFile(camera="roof", file="x.jpg", stamp="1", time=NOON, code="file_copy")
    archive.seen_files.add([*files, left_out, SeenFile(camera="roof", file="y.jpg", stamp="1")])

    def used(since: datetime | None, until: datetime | None, limit: int = 10) -> list[str]:
        return [one.file for one in archive.seen_files.used("roof", since=since, until=until, limit=limit)]

    assert used(None, None) == ["0.jpg", "1.jpg", "2.jpg", "3.jpg"]
    assert used(TIMES[2], TIMES[0]) == ["1.jpg", "2.jpg"]
    assert used(None, None, limit=1) == ["0.jpg"]
    archive.close()
