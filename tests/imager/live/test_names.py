"""Names of files are bytes, and what has a picture's name may be none: nothing of it ends the service or a command."""

from __future__ import annotations

import json
import os
import socket
import threading
import unicodedata
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

import pytest
from tests.archives.in_process import InProcess, use
from tests.fixtures.command_line import Sunarc, sunarc
from tests.imager.live.followed import Followed
from tests.imager.live.test_folder import MORNING, allsky, shot

from sunarc.common.foreign_files import name_text
from sunarc.sky.site import Site

__all__ = ["sunarc"]

TIMES = [MORNING + timedelta(minutes=n) for n in range(12)]
STAMPS = [f"{time:%Y%m%d%H%M%S}".encode() for time in TIMES]
PLACES = [
    b"image-%s.jpg",
    b"fold\xffer/image-%s.jpg",
    b"image-%s_\xfe.jpg",
    b"image-%s\nforged line.jpg",
    b"fold\ner/\x1b[31m/image-%s.jpg",
    b"image-%s" + b"z" * 231 + b".jpg",
    "Überblick/image-%s.jpg".encode(),
    unicodedata.normalize("NFD", "Überblick/image-%s.jpg").encode(),
    b"IMAGES/image-%s.JPG",
    b"images/image-%s.jpg",
    b"back\\xffslash/image-%s.jpg",
    "rtl\u202e/image-%s.jpg".encode(),
]
NAMES = [place % stamp for place, stamp in zip(PLACES, STAMPS, strict=True)]


def write_all(write: Callable[[str, bytes], object]) -> None:
    for name, time in zip(NAMES, TIMES, strict=True):
        write(os.fsdecode(name), shot(time))


def test_a_folder_of_such_names_is_followed_and_every_image_stored_once(tmp_path: Path) -> None:
    followed = Followed(tmp_path, TIMES[-1] + timedelta(seconds=30))
    followed.turn()
    write_all(followed.write)
    followed.turn()
    assert [point.time for point in followed.points()] == TIMES
    assert {point.verdict for point in followed.points()} == {"clear"}
    seen = followed.service.archive.seen_files.newest("roof", limit=99)
    assert len(seen) == len(TIMES)
    json.dumps([one.file for one in seen], ensure_ascii=False).encode("utf-8")
    followed.close()
    again = Followed(tmp_path, followed.clock.now())
    again.turn()
    assert again.service.archive.seen_files.newest("roof", limit=99) == seen
    assert len(again.points()) == len(TIMES)
    again.close()


def test_names_that_the_file_system_reports_are_those_of_the_listing(tmp_path: Path) -> None:
    followed = Followed(tmp_path, TIMES[2])
    followed.turn()
    path = followed.write(os.fsdecode(NAMES[2]), shot(TIMES[2]))
    followed.worker.note_names([name_text(path.relative_to(followed.root))])
    followed.turn()
    assert len(followed.points()) == 1
    followed.close()


def unfit(folder: Path) -> None:
    os.mkfifo(folder / "pipe-20250513160000.jpg")
    (folder / "folder-20250513160000.jpg").mkdir()
    (folder / "zero-20250513160000.jpg").symlink_to("/dev/zero")
    with socket.socket(socket.AF_UNIX) as one, pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)  # the path of a socket is short
        one.bind("socket-20250513160000.jpg")


def within(seconds: float, run: Callable[[], None]) -> None:
    """Run something that would otherwise block for ever."""
    done = threading.Event()

    def call() -> None:
        run()
        done.set()

    threading.Thread(target=call, daemon=True).start()
    assert done.wait(seconds)


def test_what_is_no_regular_file_is_left_out_and_blocks_nothing(tmp_path: Path) -> None:
    followed = Followed(tmp_path, MORNING)
    followed.turn()
    unfit(followed.root)
    followed.write(f"image-{TIMES[5]:%Y%m%d%H%M%S}.jpg", shot(TIMES[5]))
    followed.clock.advance(400.0)
    followed.worker.note_names(path.name for path in followed.root.iterdir())
    within(60.0, followed.turn)
    assert [point.time for point in followed.points()] == [TIMES[5]]
    followed.close()


def test_a_pipe_that_takes_the_place_of_a_listed_picture_is_refused(tmp_path: Path) -> None:
    followed = Followed(tmp_path, MORNING)
    followed.turn()
    path = followed.write(allsky(MORNING), shot(MORNING))
    file = next(iter(followed.worker._listing.files(now_ns=0)))
    path.unlink()
    os.mkfifo(path)
    within(60.0, lambda: followed.worker._take_files([file], lambda: None, live=True))
    assert followed.points() == ()
    assert followed.service.archive.seen_files.refused("roof") == {"file_not_image": 1}
    followed.close()


@pytest.fixture
def named(tmp_path: Path) -> Path:
    folder = tmp_path / os.fsdecode(b"cam\xff\nera")
    folder.mkdir()

    def write(name: str, content: bytes) -> None:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)

    write_all(write)
    unfit(folder)
    return folder


def config_of(tmp_path: Path, site: Site) -> Path:
    path = tmp_path / "sunarc.toml"
    path.write_text(
        f'name = "roof"\nstate = "{tmp_path}/state"\n[site]\nlatitude = {site.latitude}\n'
        f"longitude = {site.longitude}\naltitude = {site.altitude}\n"
    )
    return path


def test_such_names_are_ingested_and_known_again(sunarc: Sunarc, named: Path, tmp_path: Path) -> None:
    made = Followed(tmp_path, MORNING)
    site = made.service.settings.site
    made.close()
    (tmp_path / "cam").mkdir()
    config = config_of(tmp_path / "cam", site)
    for known in (0, len(TIMES)):
        answer = sunarc("ingest", str(named), "--config", str(config), "--workers=1", "--json")
        assert answer.code == 0, answer.err
        answer.out.encode("utf-8")
        summary = json.loads(answer.out)
        assert (summary["accepted"], summary["known"]) == (len(TIMES) - known, known)
        assert Path(summary["contact_sheet"]).is_file()


def test_such_names_are_reanalysed_into_tables_and_a_page(
    sunarc: Sunarc, named: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(InProcess(), monkeypatch)
    out = tmp_path / "out"
    answer = sunarc(
        *("reanalyse", str(named), "--latitude", "36.6", "--longitude", "-97.5", "--utc-offset", "0"),
        *("-o", str(out), "--yes", "--json"),
    )
    assert answer.code in {0, 1}, answer.err
    json.loads(answer.out.encode("utf-8"))
    for name in ("report.html", "report.json", "sightings.csv", "failures.csv", "epochs.json"):
        (out / name).read_bytes().decode("utf-8")


def test_such_names_are_detected_in_and_shown_as_texts(sunarc: Sunarc, named: Path) -> None:
    some = [os.fsdecode(os.fsencode(named) + b"/" + name) for name in (*NAMES[1:4], b"pipe-20250513160000.jpg")]
    answer = sunarc("detect", *some, "--json")
    assert [row["file"] for row in json.loads(answer.out)] == [name_text(one) for one in some]
    assert "not a regular file" in answer.out
    sunarc("detect", *some).out.encode("utf-8")
