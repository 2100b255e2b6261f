"""A made archive: ordinary photographs of cameras that are known, named as real archives name theirs.

Each camera has what years do to one: cloud, a bump, another lens, a clock that is an hour off, files that are broken.
"""

from __future__ import annotations

import io
import math
import tarfile
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from sunarc.common.array_types import FloatArray
from sunarc.common.utc import DAY_S, utc_time
from sunarc.lab.simulation.options import Bump
from sunarc.lab.simulation.scene import bumped_camera
from sunarc.lab.simulation.truth import SGP
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

Container = Literal["folder", "zip", "tar"]
_Picture = np.ndarray[Any, np.dtype[np.uint8]]

_PROFILE = ((0.0, 1.0, 1.7, 2.6, 5.0, 15.0, 60.0), (1.6, 1.0, 0.88, 0.79, 0.58, 0.36, 0.25))
"""Light over the level at which the sun saturates, by radii of its plateau: as real photographs show it."""
_RADIUS_SHARE = 0.028
"""Radius of the plateau over the image's side."""
_LOWEST_SUN_DEG = 78.0
_BROKEN = ("empty", "truncated", "text", "other size", "huge header", "night")
"""Kinds of broken files, in turn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraChange:
    """Change of a camera at a time: it turns (degrees, about east, north and up), or gets another lens."""

    day: int
    hour: float
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    focal_scale: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MadeCamera:
    """A camera of a made archive.

    Attributes
    ----------
    name : of its folder or archive file.
    naming : `strftime` pattern of its files' names, in the time of its clock.
    container : what its files are kept in.
    utc_offset_h : how far its clock is ahead of UTC.
    wrong_days, wrong_s : days (counted from 0) on which the clock is ahead by so many seconds more.
    changes : what happens to it, in the order of time.
    heading_deg : where the top of its image looks.
    """

    name: str
    naming: str
    container: Container = "folder"
    utc_offset_h: float = 0.0
    wrong_days: tuple[int, ...] = ()
    wrong_s: float = 3600.0
    changes: tuple[CameraChange, ...] = ()
    heading_deg: float = 20.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MadeArchive:
    """Size of a made archive.

    Attributes
    ----------
    cameras : see there.
    days, per_day : how many days, and images a day.
    step_days : from one of the days to the next: the sun's track of one season alone tells little of a lens.
    size : side of the images, px.
    first_day : midnight UTC before the first one.
    cloudy_share : share of the images in which a cloud hides the sun.
    broken : broken files a camera, in addition to its images.
    seed : of cloud and noise.
    site : where all cameras stand.
    """

    cameras: tuple[MadeCamera, ...]
    days: int = 8
    per_day: int = 40
    step_days: int = 14
    size: int = 240
    first_day: datetime = field(default_factory=lambda: utc_time(1_360_454_400.0))
    cloudy_share: float = 0.2
    broken: int = 6
    seed: int = 1
    site: Site = SGP


FOUR_CAMERAS = (
    MadeCamera(name="roof", naming="sgptsiskyimageC1.a1.%Y%m%d.%H%M%S.jpg", changes=(
        CameraChange(day=4, hour=18.2, turn_deg=(1.5, 0.0, 3.0)),
    )),
    MadeCamera(name="mast", naming="ccd1_%Y%m%d_%H%M%S.jpg", container="zip", utc_offset_h=-5.0, heading_deg=110.0,
               wrong_days=(2, 3)),
    MadeCamera(name="field", naming="image-%Y%m%d%H%M%S.jpg", container="tar", utc_offset_h=1.0, heading_deg=200.0,
               changes=(CameraChange(day=3, hour=17.9, focal_scale=1.12, turn_deg=(0.0, 0.0, 5.0)),)),
    MadeCamera(name="hut", naming="%Y%m%dT%H%M%SZ.jpg", heading_deg=300.0),
)  # fmt: skip
"""Names of four families: a camera that is bumped, one with a wrong clock, one with another lens, one untouched."""


def write_archive(made: MadeArchive, folder: Path) -> Path:
    """Write an archive of images, and `cameras.toml` for `sunarc reanalyse --cameras`; return the path of that."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = []
    for number, camera in enumerate(made.cameras):
        address = _write_container(folder / camera.name, camera.container, _make_files(made, camera, number))
        lines += [
            f"[cameras.{camera.name}]",
            f'sources = ["{address.name}"]',
            f"utc_offset = {camera.utc_offset_h}",
            "",
        ]
    path = folder / "cameras.toml"
    path.write_text("\n".join(lines))
    return path


def camera_at(made: MadeArchive, camera: MadeCamera, unix_s: float) -> Camera:
    """Return the true camera at a time."""
    focal = 0.31 * made.size
    middle = (made.size - 1) / 2.0
    pose = rotation_from_pose_angles(PoseAngles(phi_xz_deg=40.0, theta_zz_deg=1.5, psi_z_deg=camera.heading_deg))
    present = Camera(
        width=made.size,
        height=made.size,
        projection="equisolid",
        focal_length_px=(focal, focal),
        principal_point_px=(middle + 1.3, middle - 0.8),
        rotation_cam_enu=pose,
    )
    for change in camera.changes:
        at = made.first_day + timedelta(days=change.day * made.step_days, hours=change.hour)
        if unix_s >= at.timestamp():
            focal *= change.focal_scale
            turned = bumped_camera(present, Bump(at=at, turn_deg=change.turn_deg))
            present = replace(turned, focal_length_px=(focal, focal))
    return present


def true_times(made: MadeArchive) -> FloatArray:
    """Return when the images are taken, seconds since 1970-01-01 UTC: evenly over each day's sun."""
    times = []
    for day in range(made.days):
        minutes = made.first_day.timestamp() + day * made.step_days * DAY_S + 60.0 * np.arange(720, 2160)
        zenith = np.asarray(sun_angles(minutes, made.site).apparent_zenith)
        up = minutes[zenith < _LOWEST_SUN_DEG]
        times.append(up[np.linspace(0, up.size - 1, made.per_day).astype(int)] if up.size else up)
    return np.concatenate(times)


def _make_files(made: MadeArchive, camera: MadeCamera, number: int) -> Iterator[tuple[str, bytes]]:
    rng = np.random.default_rng((made.seed, number))
    times = true_times(made)
    directions = sun_directions(times, made.site)
    for time, direction in zip(times.tolist(), directions, strict=True):
        pixel = project(camera_at(made, camera, time), direction)
        hidden = bool(rng.random() < made.cloudy_share)
        yield _make_file_name(made, camera, time), encoded(photograph(made.size, pixel, rng, hidden=hidden))
    whole = encoded(photograph(made.size, np.array([60.0, 70.0]), rng))
    for broken in range(made.broken):
        kind = _BROKEN[broken % len(_BROKEN)]
        hours = 6.0 if kind == "night" else 19.0
        time = made.first_day.timestamp() + 3600.0 * hours + 61.0 * (broken + 1)
        yield _make_file_name(made, camera, time), _break_content(kind, whole, made.size)


def _make_file_name(made: MadeArchive, camera: MadeCamera, unix_s: float) -> str:
    day = (unix_s - made.first_day.timestamp() - 0.25 * DAY_S) // DAY_S / made.step_days
    ahead = 3600.0 * camera.utc_offset_h + (camera.wrong_s if day in camera.wrong_days else 0.0)
    return (utc_time(unix_s) + timedelta(seconds=ahead)).strftime(camera.naming)


def _break_content(kind: str, whole: bytes, size: int) -> bytes:
    contents: dict[str, Callable[[], bytes]] = {
        "empty": lambda: b"",
        "truncated": lambda: whole[: len(whole) // 2],
        "text": lambda: b"404 not found",
        "other size": lambda: encoded(np.zeros((size // 2, size, 3), dtype=np.uint8)),
        "huge header": lambda: _state_size(whole, 65_000),
        "night": lambda: whole,
    }
    return contents[kind]()


def _state_size(jpeg: bytes, side: int) -> bytes:
    """Return a JPEG whose header states another size (the frame header's height and width)."""
    at = jpeg.index(b"\xff\xc0") + 5
    return jpeg[:at] + side.to_bytes(2, "big") * 2 + jpeg[at + 4 :]


def photograph(size: int, sun: FloatArray, rng: np.random.Generator, *, hidden: bool = False) -> _Picture:
    """Return a photograph, (size, size, 3), with the sun at a pixel, or behind a cloud."""
    rows, columns = np.mgrid[:size, :size].astype(np.float32)
    if hidden:
        light = 0.55 + 0.1 * _draw_texture(rng, size, 0.15 * size) + 0.03 * _draw_texture(rng, size, 0.04 * size)
    else:
        far = np.hypot(columns - sun[0], rows - sun[1]) / (_RADIUS_SHARE * size)
        light = np.interp(far, *_PROFILE) + 0.02 * np.minimum(far / 1.7, 2.0) * _draw_texture(rng, size, 0.07 * size)
    light[np.hypot(columns - size / 2, rows - size / 2) > 0.49 * size] = 0.03
    colours = light[..., None] * np.array([1.12, 1.05, 1.0]) + rng.normal(0.0, 0.006, (size, size, 1))
    return np.asarray(np.round(255.0 * np.clip(colours, 0.0, 1.0)), dtype=np.uint8)


def _draw_texture(rng: np.random.Generator, size: int, scale_px: float) -> FloatArray:
    cells = math.ceil(size / scale_px) + 3
    wide = cv2.resize(rng.standard_normal((cells, cells)), (size, size), interpolation=cv2.INTER_CUBIC)
    return np.asarray((wide - wide.mean()) / wide.std(), dtype=np.float64)


def encoded(picture: _Picture) -> bytes:
    """Return a picture as a JPEG."""
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()


def _write_container(path: Path, container: Container, files: Iterator[tuple[str, bytes]]) -> Path:
    if container == "zip":
        with zipfile.ZipFile(path.with_suffix(".zip"), "w") as archive:
            for name, content in files:
                archive.writestr(zipfile.ZipInfo(name), content)
        return path.with_suffix(".zip")
    if container == "tar":
        with tarfile.open(path.with_suffix(".tar"), "w") as tar:
            for name, content in files:
                info = tarfile.TarInfo(name)
                info.size = len(content)
                tar.addfile(info, io.BytesIO(content))
        return path.with_suffix(".tar")
    path.mkdir(exist_ok=True)
    for name, content in files:
        (path / name).write_bytes(content)
    return path
