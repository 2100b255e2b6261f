"""A camera whose images are not those of the stored pose is refused before anything of it is stored."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
from tests.fixtures.archive import make_empty
from tests.fixtures.cameras import INFO

from sunarc.common.errors import InputError
from sunarc.imager.app.service import Service
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.cameras.frame import CameraCondition, CameraInfo, Frame
from sunarc.imager.cameras.options import AravisOptions
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.settings.model import Settings
from sunarc.sky.site import Site


class Camera:
    def __init__(self, info: CameraInfo) -> None:
        self.info = info
        self.closed = False

    def expose(self, exposure_us: float) -> Frame:
        raise AssertionError(f"{exposure_us} us were asked of a camera that was to be refused")

    def distrust(self) -> None: ...

    def check(self) -> CameraCondition:
        return CameraCondition()

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def archive(tmp_path: Path) -> Iterator[Archive]:
    make_empty(tmp_path / "sunarc.sqlite")
    opened = open_archive(tmp_path / "sunarc.sqlite")
    yield opened
    opened.close()


def service(archive: Archive, camera: Camera, tmp_path: Path) -> Service:
    settings = Settings(
        state=tmp_path, site=Site(latitude=36.6, longitude=-97.5), camera=AravisOptions(address="127.0.0.9")
    )
    clock = VirtualClock(datetime(2013, 5, 13, 18, tzinfo=UTC))
    return Service(settings, archive=archive, clock=clock, open_camera=lambda: camera)


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (replace(INFO, width=9), "9×6 px, those stored 8×6"),
        (replace(INFO, pixel_format="BayerRG12"), "in BayerRG12, those stored in Mono12"),
    ],
)
def test_images_of_another_size_or_format_are_refused_with_the_remedy(
    archive: Archive, tmp_path: Path, other: CameraInfo, words: str
) -> None:
    service(archive, Camera(INFO), tmp_path).open_and_remember()
    camera = Camera(other)
    made = service(archive, camera, tmp_path)
    with pytest.raises(InputError, match=words) as caught:
        made.open_and_remember()
    assert "another name than 'imager'" in caught.value.remedy
    assert camera.closed
    assert archive.cameras.all()[0].width == INFO.width


def test_the_service_stays_up_and_says_so(archive: Archive, tmp_path: Path) -> None:
    service(archive, Camera(INFO), tmp_path).open_and_remember()
    made = service(archive, Camera(replace(INFO, width=9)), tmp_path)
    stop, turns = threading.Event(), iter(range(10))

    def heartbeat() -> None:
        if next(turns, None) is None:
            stop.set()

    made.capture_worker().run(stop, heartbeat)
    (reason,) = made.board.snapshot().reasons
    assert (reason.code, reason.severity) == ("camera_refused", "not_ready")
    assert len(made.cycles) == 0


def test_the_same_camera_is_welcome_again(archive: Archive, tmp_path: Path) -> None:
    for _ in range(2):
        assert service(archive, Camera(INFO), tmp_path).open_and_remember().info == INFO
