"""Feed damaged files to every reader of files: each answers or refuses in one line, within a second.

    .venv/bin/python -m tests.sources.fuzz --count 1000000 --seed 1

draws so many cases in all from the sound files of every reader: bytes and numbers changed, cut, doubled, joined, and
replaced by what numbers, names and nests can be; what was answered in a new way is damaged further. A case fails that
raises anything but the project's own errors, takes longer than a second of processor, more than 300 MB, or ends the
process, in which each reader is asked apart. Printed is a table by reader; failures are shortened and kept in
`--keep`. `--only NAME` asks one reader.
"""

from __future__ import annotations

import argparse
import gzip
import io
import json
import mmap
import multiprocessing
import os
import random
import re
import resource
import signal
import sqlite3
import struct
import sys
import tempfile
import traceback
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, Literal, NamedTuple

import cv2
import h5netcdf
import h5py
import numpy as np
from astropy.io import fits
from numpy.typing import NDArray
from PIL import Image as Pictures
from tests.fixtures.calibration import distinctive_calibration

from sunarc.archives.ledger import ImageId, Known, Ledger
from sunarc.calibration.model.result import Calibration
from sunarc.common.errors import InputError, SunarcError
from sunarc.common.findings import Finding, FindingError
from sunarc.detection.stars.warm_pixels import SensorFormat
from sunarc.formats.calibration_document import from_document, to_document
from sunarc.formats.csv_files import read_pairs, read_sightings
from sunarc.formats.formats import FORMATS, read_view
from sunarc.formats.lens_prior import lens_type_from_json
from sunarc.imager.archive.database.recovery import Column, leaf_rows
from sunarc.imager.archive.feed_rows import FeedRow, feed_lines, read_feed_lines
from sunarc.imager.settings.load import load_hub_settings, load_settings
from sunarc.imager.web.arrays import read_rows
from sunarc.imager.workers.night.images import WarmPixelFile
from sunarc.imaging.metadata import embedded_document, jpeg_with, png_with
from sunarc.lab.studies.benchmark_cases import BenchmarkTruth
from sunarc.lab.studies.benchmark_files import read_case, read_entry
from sunarc.lab.studies.benchmark_scores import score
from sunarc.public.calibrate_files import read_joint_spec
from sunarc.sky.site import Site
from sunarc.sources.files import read_image, read_lines
from sunarc.sources.fits_files import fits_bayer, fits_frame, fits_image, fits_site
from sunarc.sources.image_files import checked_image, read_one_image
from sunarc.sources.image_times import TimeRules, exif_time, sidecar_time, timed_frames
from sunarc.sources.index import CameraPlan, Selector, read_cameras
from sunarc.sources.look import PackedMask
from sunarc.sources.sources import open_source
from sunarc.sources.stack_files import netcdf_frames, netcdf_images, video_frames, video_images

ROOT = Path(__file__).resolve().parents[2]
SLOWEST_S = 1.0
"""Of processor, for a case."""
LONGEST_S = 60.0
"""For a case by the wall's clock: it hangs."""
MOST_MB = 300.0
"""Of memory, for a case, and by which all of a reader may grow."""
_MOST_EDITS = 6
_KINDS = ("set", "set", "set", "flip", "cut", "double", "end")
_NUMBERS = (0, 1, -1, 2**7, 2**8 - 1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 1000, 65_537)
_SOUND_SHARE, _SPLICED_SHARE, _RIGHT_SUMS_SHARE = 0.5, 0.1, 0.7
_MOST_KEPT, _LONGEST_KEPT = 200, 1 << 16
_SETTLED, _LOOKED_EVERY = 2000, 1000
_LOOK_S, _MOST_DEATHS, _MOST_TRIES = 0.05, 20, 300
_LONGEST_ANSWER = 200
CHEAP, DEAR, SLOW = 16, 4, 1
"""Weights: readers of less than a quarter of a millisecond a case, of less than one, of more."""
_SLOW_VIEWS = frozenset({"mrcal", "netcdf", "opencv-remap", "fits", "matlab", "map-netcdf", "map-npz", "ros"})
_SHAPE = re.compile(r"[\d.'\"\\]+|0x[0-9a-f]+")
_IN_MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None  # noqa: S108 - a folder of its own is made there
TOKENS = (
    b"", b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"nan", b"NaN", b"-inf", b"Infinity", b"1e999", b"-1", b"0", b"-0.0",
    b"1e-320", b"9" * 400, b"1" * 5000, b"2013-02-30T25:61:61Z", b"9999-12-31T23:59:59.9999999Z",
    b"0001-01-01T00:00:00Z",
    b"null", b"true", b'""', b"[]", b"{}", b"[" * 3000, b'{"a":' * 3000, b",", b"\n", b"\r", b'"', b"'", b"\\", b"#",
    b"!!python/object/apply:os.system", b"&a [*a]", b"%YAML 9.9", b"\xf0\x9f\x8c\x9e", b"\xc3\x28", b"../../etc/passwd",
)  # fmt: skip
"""What is set into a file."""


@dataclass(frozen=True)
class Reader:
    """A reader of files: `read` takes a file's bytes and a folder of its own; `sound` are files that it reads.

    Of a dear one fewer cases are asked, by its `weight`.
    """

    name: str
    sound: tuple[bytes, ...]
    read: Callable[[bytes, Path], object]
    weight: int = CHEAP

    def share_of(self, count: int, asked: list[Reader]) -> int:
        """Return how many of so many cases are this reader's."""
        return -(-count * self.weight // sum(one.weight for one in asked))


@dataclass(frozen=True)
class Failure:
    """A file that a reader did not bear."""

    reader: str
    content: bytes
    why: str


class Asked(NamedTuple):
    """How a file was taken: a word for the answer, what is wrong with it, if anything, and the processor seconds."""

    answer: str
    why: str | None
    refused: bool
    took_s: float


@dataclass
class Tally:
    """How the cases of a reader went; of failures of one cause one is kept, shortened."""

    reader: str
    answered: int = 0
    refused: int = 0
    n_failed: int = 0
    slowest_s: float = 0.0
    grown_mb: float = 0.0
    failures: dict[str, Failure] = field(default_factory=dict)

    def note(self, reader: Reader, content: bytes, asked: Asked, folder: Path) -> None:
        """Count a case."""
        self.slowest_s = max(self.slowest_s, asked.took_s)
        if asked.why is None:
            self.refused += asked.refused
            self.answered += not asked.refused
            return
        self.n_failed += 1
        kind = kind_of_failure(asked.why)
        if kind not in self.failures:
            short = content if kind == "took" else shortened(reader, content, kind, folder)
            self.failures[kind] = Failure(self.reader, short, asked.why)

    def add(self, other: Tally) -> None:
        """Count further cases of the same reader."""
        self.answered += other.answered
        self.refused += other.refused
        self.n_failed += other.n_failed
        self.slowest_s = max(self.slowest_s, other.slowest_s)
        self.grown_mb = max(self.grown_mb, other.grown_mb)
        self.failures = other.failures | self.failures

    @property
    def n_cases(self) -> int:
        """How many were asked."""
        return self.answered + self.refused + self.n_failed

    def row(self) -> str:
        """Return a row of a table."""
        numbers = (f"{one:,}" for one in (self.n_cases, self.answered, self.refused, self.n_failed))
        return f"| {self.reader} | {' | '.join(numbers)} | {self.slowest_s:.2f} | {self.grown_mb:.0f} |"


class Pool:
    """Files to damage: the sound ones, and damaged ones that were answered in a way that none before was."""

    def __init__(self, sound: tuple[bytes, ...]) -> None:
        self._files, self._sound = list(sound), len(sound)
        self._seen: set[str] = set()

    def __len__(self) -> int:
        return len(self._files)

    def drawn(self, chance: random.Random) -> bytes:
        """Return a damaged file, a sound one's in half of the cases."""
        known = self._files[: self._sound] if chance.random() < _SOUND_SHARE else self._files
        content = chance.choice(known)
        if chance.random() < _SPLICED_SHARE:
            other = chance.choice(self._files)
            content = content[: chance.randrange(len(content) + 1)] + other[chance.randrange(len(other) + 1) :]
        content = edited(content, edits(chance, len(content)))
        return with_right_sums(content) if content[1:4] == b"PNG" and chance.random() < _RIGHT_SUMS_SHARE else content

    def note(self, content: bytes, answer: str) -> None:
        """Keep a file whose answer is new, while there is room."""
        if answer not in self._seen and len(content) <= _LONGEST_KEPT and len(self._files) < _MOST_KEPT:
            self._seen.add(answer)
            self._files.append(content)


def edits(chance: random.Random, length: int) -> list[tuple[str, int, int, bytes]]:
    """Return some changes of a file of a length."""
    made = []
    for _ in range(chance.choice((1, 1, 1, 2, 3, _MOST_EDITS))):
        what = chance.randrange(3)
        if what == 0:
            token = chance.choice(TOKENS)
        elif what == 1:
            token = chance.randbytes(chance.randrange(1, 9))
        else:
            order: Literal["big", "little"] = chance.choice(("big", "little"))
            token = (chance.choice(_NUMBERS) & (2**64 - 1)).to_bytes(8, order)
            width = chance.choice((1, 2, 4, 8))
            token = token[-width:] if order == "big" else token[:width]
        width = len(token) if what == 2 else chance.randrange(41)
        made.append((chance.choice(_KINDS), chance.randrange(length + 1), width, token))
    return made


def edited(sound: bytes, changes: list[tuple[str, int, int, bytes]]) -> bytes:
    """Return a file changed at some places; places are taken modulo its length."""
    content = bytearray(sound)
    for kind, place, length, token in changes:
        begin = place % (len(content) + 1)
        end = min(begin + length, len(content))
        if kind == "set":
            content[begin:end] = token
        elif kind == "cut":
            del content[begin:end]
        elif kind == "end":
            del content[begin:]
        elif kind == "double":
            content[begin:begin] = content[begin:end] * 3
        elif begin < len(content):
            content[begin] ^= 1 << (length % 8)
    return bytes(content)


def with_right_sums(png: bytes) -> bytes:
    """Return a PNG whose chunks have the sums of what is in them: else no decoder looks further."""
    made, at = bytearray(png[:8]), 8
    while at + 12 <= len(png):
        (length,) = struct.unpack_from(">I", png, at)
        body = png[at + 4 : at + 8 + length]
        made += png[at : at + 4] + body + struct.pack(">I", zlib.crc32(body))
        at += 12 + length
    return bytes(made)


def at_path(name: str, read: Callable[[Path], object]) -> Callable[[bytes, Path], object]:
    """Return a reader of a path as one of bytes."""

    def of_bytes(content: bytes, folder: Path) -> object:
        path = folder / name
        path.write_bytes(content)
        return read(path)

    return of_bytes


def of_json(read: Callable[[object], object]) -> Callable[[bytes, Path], object]:
    """Return a reader of a JSON value as one of bytes; what is no JSON does not come to it."""

    def of_bytes(content: bytes, _: Path) -> object:
        try:
            value = json.loads(content)
        except (ValueError, RecursionError):
            return None
        return read(value)

    return of_bytes


def entry_of(content: bytes, folder: Path) -> object:
    """Read and score an entry of the benchmark."""
    (folder / "s000.csv").write_bytes(content)
    pixels, directions = np.array([[k, 5.0] for k in range(9)]), np.tile([0.0, 0.6, 0.8], (9, 1))
    said = {"lens": "a", "condition": "b", "answerable": True, "track_deg": np.zeros(9), "fallback_deg": np.ones(9)}
    truth = BenchmarkTruth(pixels=pixels, directions=directions, px_per_deg=np.tile(np.eye(2), (9, 1, 1)), **said)  # type: ignore[arg-type] # columns by name
    truths = {"s000": truth}
    return score("entrant", truths, read_entry(folder, truths))


def case_of(content: bytes, folder: Path) -> object:
    """Read a case of the benchmark with its sightings damaged."""
    (folder / "case.json").write_text(
        '{"case": "s000", "latitude": 1, "longitude": 2, "altitude": 3, "width": 9, "height": 9, "projection": null}'
    )
    (folder / "queries.csv").write_text("x_px,y_px\n1,2\n")
    (folder / "sightings.csv").write_bytes(content)
    return read_case(folder)


def readers() -> list[Reader]:
    """Return all readers with their sound files."""
    solved, day = small(distinctive_calibration()), datetime(2013, 5, 13, tzinfo=UTC)
    document = to_document(
        solved, id="one", camera="roof", state="current", created_at=day, valid_from=day, valid_until=None,
        pose_epoch="1", software_version="0.4.0",
    )  # fmt: skip
    rows = b"".join(b"2013-05-13T%02d:00:00Z,%d.5,71,0.3,sun,,\n" % (hour, 10 * hour) for hour in range(11, 20))
    sightings = b"time_utc,x_px,y_px,sigma_px,body,zenith_deg,azimuth_deg\n" + rows
    seen = b"time_utc,x_px,y_px,sigma_px,body,zenith_deg,azimuth_deg,apparent_zenith_deg,apparent_azimuth_deg\n"
    image = (np.arange(400).reshape(20, 20) % 251).astype(np.uint8)
    npy = io.BytesIO()
    np.save(npy, np.arange(12.0).reshape(6, 2))
    entry = b"x_px,y_px,zenith_deg,azimuth_deg,sigma_deg\n" + b"".join(b"%d,5,45,90,0.1\n" % k for k in range(9))
    found = [
        Reader("sightings", (sightings,), at_path("a.csv", lambda p: read_sightings(read_lines(p), name=p.name))),
        Reader(
            "pairs",
            (b"x_px,y_px\n1,2\n3.5,4\n",),
            at_path("a.csv", lambda p: read_pairs(read_lines(p), columns=("x_px", "y_px"), name=p.name)),
        ),
        Reader("settings", ((ROOT / "deploy" / "sunarc.toml").read_bytes(),), at_path("a.toml", load_settings)),
        Reader("hub", ((ROOT / "deploy" / "hub" / "hub.toml").read_bytes(),), at_path("a.toml", load_hub_settings)),
        Reader("npy", (npy.getvalue(),), lambda content, _: read_rows(content, columns=(2, 3), most=1000)),
        Reader("document", (json.dumps(document).encode(),), of_json(from_document)),
        Reader(
            "feed",
            (feed_lines([FeedRow(seq=1, kind="day", data={"a": 1.5}), FeedRow(seq=2, kind="status", data=None)]),),
            feed_of,
        ),
        Reader("entry", (entry,), entry_of, DEAR),
        Reader("case", (seen + rows.replace(b",,\n", b",,,45,90\n"),), case_of),
        Reader("joint", (b'latitude = 1.0\nlongitude = 2.0\n[[entry]]\ncamera = "a"\nfile = "a.csv"\n',), joint_of),
        Reader("lens", (b'{"units": [], "lens": {"projection": "equisolid"}}',), of_json(lens_type_from_json)),
    ]
    for form in FORMATS.values():
        if form.read is not None:
            try:
                made = form.write(solved, document)
            except (InputError, ModuleNotFoundError):
                continue
            read = paired(made.content, form.name) if form.name.startswith("azimuth-zenith") else view_of
            found.append(Reader(f"view-{form.name}", (made.content,), read, SLOW if form.name in _SLOW_VIEWS else DEAR))
    for ending in (".png", ".jpg", ".tiff", ".bmp"):
        content = cv2.imencode(ending, image)[1].tobytes()
        found.append(Reader(f"image{ending}", (content,), at_path("a" + ending, read_image)))
    for ending in (".png", ".jpg", ".tiff", ".bmp", ".webp"):
        coded = tuple(cv2.imencode(ending, one)[1].tobytes() for one in (image, np.dstack([image] * 3)))
        found.append(Reader(f"archive{ending}", coded, lambda content, _: checked_image(content, "a")))
    return found + archive_readers(image) + state_readers()


def small(solved: Calibration) -> Calibration:
    """Return a calibration of a camera whose maps are small."""
    camera = solved.camera
    scale = 96.0 / camera.width
    return replace(
        solved,
        camera=replace(
            camera,
            width=96,
            height=round(scale * camera.height),
            focal_length_px=(scale * camera.focal_length_px[0], scale * camera.focal_length_px[1]),
            principal_point_px=(scale * camera.principal_point_px[0], scale * camera.principal_point_px[1]),
        ),
    )


def archive_readers(image: NDArray[np.uint8]) -> list[Reader]:
    """Return the readers of what an archive holds beside pictures, and of what pictures say of themselves."""
    said = {"schema": "sunarc.image/1", "time_utc": "2013-05-13T12:00:00Z", "exposure_us": 20.5}
    jpeg, png = (cv2.imencode(ending, image)[1].tobytes() for ending in (".jpg", ".png"))
    pictures = (jpeg_with(jpeg, said), png_with(png, said, software="a", created="2013-05-13T12:00:00Z"))
    tagged, exif = io.BytesIO(), Pictures.Exif()
    exif[306] = "2013:05:13 12:00:00"
    exif.get_ifd(0x8769).update({0x9003: "2013:05:13 12:00:00", 0x9011: "+02:00"})
    Pictures.fromarray(image).save(tagged, "JPEG", exif=exif)
    cameras = b'[cameras.roof]\nlatitude = 1.0\nlongitude = 2.0\naltitude = 3.0\nsources = ["a"]\nsize = [8, 6]\n'
    common = CameraPlan(name="a", site=Site(latitude=1.0, longitude=2.0), selector=Selector(sources=("a",)))
    return [
        Reader("document-in-image", pictures, lambda content, _: embedded_document(content)),
        Reader("exif", (tagged.getvalue(),), lambda content, _: exif_time(io.BytesIO(content))),
        Reader("sidecar", (json.dumps(said).encode(),), lambda content, _: sidecar_time(content, "a", None)),
        Reader("cameras", (cameras,), at_path("cameras.toml", lambda p: read_cameras(p, common=common))),
        Reader("fits", (fits_file(image), fits_tiles(image)), fits_of, SLOW),
        Reader("fits.gz", (gzip.compress(fits_file(image)),), in_folder("a.fits.gz"), SLOW),
        Reader("netpbm", (*netpbm_files(image), text_netpbm(image)), in_folder("a.pgm")),
        Reader("netpbm.gz", tuple(map(gzip.compress, netpbm_files(image))), in_folder("a.pgm.gz"), DEAR),
        Reader("bmp.gz", (gzip.compress(cv2.imencode(".bmp", image)[1].tobytes()),), in_folder("a.bmp.gz"), DEAR),
        Reader("trex", (trex_file(image),), netcdf_of, SLOW),
        Reader("netcdf", (netcdf_file(image),), netcdf_of, SLOW),
        Reader("video", (video_file(image, "avi", "MJPG"), video_file(image, "mp4", "mp4v")), video_of, SLOW),
    ]


def state_readers() -> list[Reader]:
    """Return the readers of what the service and an analysis keep in databases and files of their own."""
    columns = (
        Column("id", "INTEGER", True, True),
        Column("name", "TEXT", True, False),
        Column("x", "REAL", False, False),
    )
    sensor = SensorFormat(rows=10, columns=10, pixel_format="Mono12", binning=1, serial="a")
    warm = {"version": 1, "sensor": sensor._asdict(), "pixels": [3, 7, 50]}
    return [
        Reader("leaf-rows", (database_file(),), at_path("a.sqlite", lambda p: list(leaf_rows(p, columns))), DEAR),
        Reader("ledger", (ledger_file(),), at_path("a.sqlite", ledger_of), SLOW),
        Reader(
            "warm-pixels",
            (json.dumps(warm).encode(),),
            at_path("a.json", lambda p: WarmPixelFile(p, lambda _: None).read(sensor)),
        ),
    ]


def fits_file(image: NDArray[np.uint8]) -> bytes:
    """Return a FITS file with a time, an exposure and a site."""
    made, header = io.BytesIO(), fits.Header()
    header.update({"DATE-OBS": "2013-05-13T22:00:00.5", "EXPTIME": 20.0, "SITELAT": 36.6, "SITELONG": -97.5})
    fits.PrimaryHDU(image.astype(np.uint16), header).writeto(made)
    return made.getvalue()


def fits_of(content: bytes, _: Path) -> object:
    fits_frame(content, "a")
    fits_site(content, "a")
    fits_bayer(content, "a")
    return fits_image(content, "a", size=None)


def fits_tiles(image: NDArray[np.uint8]) -> bytes:
    """Return a FITS file of compressed tiles."""
    made = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(image.astype(np.uint16) * 100)]).writeto(made)
    return made.getvalue()


def text_netpbm(image: NDArray[np.uint8]) -> bytes:
    """Return a PGM whose counts are text."""
    small = image[:16, :16] if image.ndim == 2 else image[:16, :16, 0]
    return (
        b"P2\n# text\n%d %d\n255\n" % small.shape[::-1] + "\n".join(" ".join(map(str, row)) for row in small).encode()
    )


def netpbm_files(image: NDArray[np.uint8]) -> tuple[bytes, ...]:
    """Return a PGM file, a PPM file, and one of two images with their times."""
    comments = b'#"Image request start" 2013-05-13 12:30:00.017 UTC\n#"Subframe requested exposure" 1000.0 ms\n'
    deep = b"P5\n" + comments + b"20 20\n65535\n" + image.astype(">u2").tobytes()
    grey, colours = (cv2.imencode(*one)[1].tobytes() for one in ((".pgm", image), (".ppm", np.dstack([image] * 3))))
    return grey, colours, deep + deep


def trex_file(image: NDArray[np.uint8]) -> bytes:
    """Return an HDF5 file of two colour images as TREx's."""
    made = io.BytesIO()
    with h5py.File(made, "w") as file:
        file["data/images"] = np.stack([np.dstack([image] * 3)] * 2, axis=-1)
        file["data/timestamp"] = np.array([b"2013-05-13 12:30:00.017 UTC", b"2013-05-13 12:30:03.017 UTC"])
    return made.getvalue()


def in_folder(name: str) -> Callable[[bytes, Path], object]:
    """Return a reader of a file of a folder: its times, then its first image."""

    def read(content: bytes, folder: Path) -> object:
        (folder / name).write_bytes(content)
        source = open_source(str(folder))
        timed_frames(source, name, TimeRules(offset=timedelta(0)), names=())
        found = read_one_image(source, name)
        if isinstance(found, Finding):
            raise FindingError(name, found)
        return found

    return read


def netcdf_file(image: NDArray[np.uint8]) -> bytes:
    """Return a NetCDF file with two images and their times."""
    made = io.BytesIO()
    with h5netcdf.File(made, "w") as file:
        file.dimensions = {"time": 2, "y": 20, "x": 20}
        times = file.create_variable("time", ("time",), float, data=np.array([0.0, 30.0]))
        times.attrs["units"] = "seconds since 2013-05-13 12:00:00"
        file.create_variable("image", ("time", "y", "x"), np.uint8, data=np.stack([image, image]))
    return made.getvalue()


def netcdf_of(content: bytes, _: Path) -> object:
    numbers = [frame.number for frame in netcdf_frames(content, "a")][:3]
    return list(netcdf_images(content, "a", numbers, size=None))


def video_file(image: NDArray[np.uint8], ending: str, code: str) -> bytes:
    """Return a video of three frames, one a second."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a.{ending}"
        made = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), 1.0, (64, 48))
        for _ in range(3):
            made.write(cv2.resize(np.dstack([image] * 3), (64, 48)))
        made.release()
        return path.read_bytes()


def video_of(content: bytes, _: Path) -> object:
    with suppress(FindingError):  # it does not say when it was made
        video_frames(content, "a", sidecar=None)
    video_frames(content, "a", sidecar=b'{"start_utc": "2013-05-13T12:00:00Z", "interval_s": 30}')
    return list(video_images(content, "a", [0, 2], size=None))


def database_file() -> bytes:
    """Return a SQLite database of a table that has rows."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.sqlite"
        connection = sqlite3.connect(path)
        connection.execute("CREATE TABLE a (id INTEGER PRIMARY KEY, name TEXT NOT NULL, x REAL)")
        connection.executemany("INSERT INTO a (name, x) VALUES (?, ?)", [("a" * k, k / 3.0) for k in range(150)])
        connection.execute("DELETE FROM a WHERE id < 40")
        connection.commit()
        connection.close()
        return path.read_bytes()


def ledger_file() -> bytes:
    """Return a ledger of an analysis with an answer, a mask and a result."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.sqlite"
        with Ledger(f"sqlite:///{path}") as ledger:
            known = Known("key", Finding("file_truncated"))
            ledger.store("roof", 1, [(ImageId("a", "b.jpg", 0), known)], version="1")
            ledger.keep_mask("roof", PackedMask((2, 2), zlib.compress(b"1")), version="1")
            ledger.keep_result("name", "key", [1.5, "a"])
        connection = sqlite3.connect(path)
        connection.execute("PRAGMA journal_mode=DELETE")
        connection.close()
        return path.read_bytes()


def ledger_of(path: Path) -> tuple[list[Any], Any]:
    for beside in ("-wal", "-shm", "-journal"):
        path.with_name(path.name + beside).unlink(missing_ok=True)
    with Ledger(f"sqlite:///{path}") as ledger:
        found = list(ledger.answers("roof", pass_number=1))
        ledger.mask("roof", version="1")
        return found, ledger.result("name", "key")


def feed_of(content: bytes, _: Path) -> object:
    return read_feed_lines(content, after=0)


def view_of(content: bytes, _: Path) -> object:
    return read_view(content, name="a", beside=lambda _: None)


def paired(sound: bytes, name: str) -> Callable[[bytes, Path], object]:
    """Return a reader of one of two images, beside which the other one is sound."""
    named = f"azimuth_a.{name.rpartition('-')[2]}"
    return lambda content, _: read_view(content, name=named, beside=lambda _: sound)


def joint_of(content: bytes, folder: Path) -> object:
    (folder / "joint.toml").write_bytes(content)
    return read_joint_spec(folder / "joint.toml")


class Board:
    """What a process says while it asks, in memory that outlives it: the case, and how it went so far.

    Parameters
    ----------
    size : bytes for the present file.
    """

    _HEAD = struct.Struct("6q")

    def __init__(self, size: int = 1 << 22) -> None:
        self._shared = mmap.mmap(-1, size)
        self.write(Tally(""), 0, b"")

    def write(self, tally: Tally, case: int, content: bytes) -> None:
        """Note a case that begins."""
        kept = content[: len(self._shared) - self._HEAD.size]
        slowest = round(1e6 * tally.slowest_s)
        head = (case, len(kept), tally.answered, tally.refused, slowest, round(1e3 * tally.grown_mb))
        self._shared[: self._HEAD.size] = self._HEAD.pack(*head)
        self._shared[self._HEAD.size : self._HEAD.size + len(kept)] = kept

    def read(self) -> tuple[int, bytes, Tally]:
        """Return the present case, its file, and how those before went."""
        case, length, answered, refused, slowest, grown = self._HEAD.unpack_from(self._shared)
        tally = Tally("", answered=answered, refused=refused, slowest_s=slowest / 1e6, grown_mb=grown / 1e3)
        return case, bytes(self._shared[self._HEAD.size : self._HEAD.size + length]), tally


def fuzzed(reader: Reader, *, count: int, number: int, first: int = 0, board: Board | None = None) -> Tally:
    """Ask a reader so many damaged files; return how it went.

    Parameters
    ----------
    reader : that is asked.
    count, number : of cases, and the seed.
    first : case to begin with.
    board : where each case is noted before it is asked.
    """
    tally, pool, begun_mb = Tally(reader.name), Pool(reader.sound), 0.0
    with tempfile.TemporaryDirectory(dir=_IN_MEMORY) as name:
        folder = Path(name)
        for case in range(first, count):
            content = pool.drawn(random.Random(f"{number} {reader.name} {case}"))
            if board is not None:
                board.write(tally, case, content)
            before_mb = peak_mb()
            asked = ask(reader, content, folder)
            if peak_mb() - before_mb > MOST_MB:
                asked = asked._replace(why=f"took {peak_mb() - before_mb:.0f} MB")
            tally.note(reader, content, asked, folder)
            pool.note(content, asked.answer)
            if case - first == _SETTLED:
                begun_mb = memory_mb()
            elif begun_mb and case % _LOOKED_EVERY == 0:
                tally.grown_mb = max(tally.grown_mb, memory_mb() - begun_mb)
    if tally.grown_mb > MOST_MB:
        tally.failures["grows"] = Failure(reader.name, b"", f"grew by {tally.grown_mb:.0f} MB in {count} cases")
    return tally


def fuzzed_apart(reader: Reader, *, count: int, number: int, longest_s: float = LONGEST_S) -> Tally:
    """Ask a reader in a process of its own, which may die or hang: the next one goes on behind that case."""
    fork, whole, first = multiprocessing.get_context("fork"), Tally(reader.name), 0
    while first < count:
        board, said = Board(), fork.SimpleQueue()

        def run(first: int = first, board: Board = board, said: Any = said) -> None:  # noqa: ANN401 - a queue
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # what libraries print of damaged files
            said.put(fuzzed(reader, count=count, number=number, first=first, board=board))

        process = fork.Process(target=run)
        process.start()
        known, since = -1, perf_counter()
        while process.is_alive() and said.empty():
            process.join(_LOOK_S)
            case = board.read()[0]
            known, since = (known, since) if case == known else (case, perf_counter())
            if perf_counter() - since > longest_s:
                process.kill()
                process.join()
        if not said.empty():
            whole.add(said.get())
            process.join()
            return whole
        case, content, tally = board.read()
        why = "hangs" if process.exitcode == -signal.SIGKILL else f"ended by signal {-(process.exitcode or 0)}"
        tally.failures[f"{why} {len(whole.failures)}"] = Failure(reader.name, content, why)
        tally.n_failed = 1
        whole.add(tally)
        if len(whole.failures) > _MOST_DEATHS:
            return whole
        first = case + 1
    return whole


def ask(reader: Reader, content: bytes, folder: Path) -> Asked:
    """Return how a reader takes a file, and what is wrong with that; it has to answer or to refuse it in time."""
    begin = process_time()
    answer, why, refused = "", None, False
    try:
        answer = type(reader.read(content, folder)).__name__
    except SunarcError as error:
        refused, answer = True, _SHAPE.sub("", f"{type(error).__name__} {error}")[:_LONGEST_ANSWER]
        if "\n" in str(error).strip() and reader.name not in {"settings", "hub"}:
            why = f"a refusal of several lines: {str(error)[:200]!r}"
    except Exception as error:  # noqa: BLE001 - whatever comes is what is sought
        at = traceback.extract_tb(error.__traceback__)[-1]
        why = f"{type(error).__name__} in {Path(at.filename).name}:{at.lineno}: {str(error)[:200]}"
    took_s = process_time() - begin
    if why is None and took_s > SLOWEST_S:
        why = f"took {took_s:.1f} s"
    return Asked(answer, why, refused, took_s)


def shortened(reader: Reader, content: bytes, kind: str, folder: Path) -> bytes:
    """Return a shorter file that the reader does not bear for the same reason."""
    width, tries = max(len(content) // 2, 1), 0
    while width and tries < _MOST_TRIES:
        at = 0
        while at < len(content) and tries < _MOST_TRIES:
            tries += 1
            shorter = content[:at] + content[at + width :]
            why = ask(reader, shorter, folder).why
            if why is not None and kind_of_failure(why) == kind:
                content = shorter
            else:
                at += width
        width //= 2
    return content


def kind_of_failure(why: str) -> str:
    """Return what failures of one cause have in common."""
    return why.partition(": ")[0] if not why.startswith("took") else "took"


def main() -> int:
    """Ask all readers; exit 1 where one fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=2000, help="cases in all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2, help="readers at once")
    parser.add_argument("--only", action="append", default=[])
    parser.add_argument("--keep", type=Path, help="folder for the files that fail")
    chosen = parser.parse_args()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    asked = [one for one in readers() if not chosen.only or one.name in chosen.only]
    n, failures, begin = 0, 0, perf_counter()
    print(
        "| reader | cases | answered | refused | failed | slowest, s | more memory, MB |\n|---|---|---|---|---|---|---|"
    )

    def tally_of(reader: Reader) -> Tally:
        return fuzzed_apart(reader, count=reader.share_of(chosen.count, asked), number=chosen.seed)

    for tally in ThreadPoolExecutor(chosen.jobs).map(tally_of, asked):
        n += tally.n_cases
        print(tally.row(), flush=True)
        failures += tally.n_failed + ("grows" in tally.failures)
        for number, one in enumerate(tally.failures.values()):
            print(f"{one.reader}: {one.why}: {one.content[:80]!r}", file=sys.stderr, flush=True)
            if chosen.keep is not None:
                chosen.keep.mkdir(parents=True, exist_ok=True)
                (chosen.keep / f"{one.reader}-{number}").write_bytes(one.content)
    took_s = perf_counter() - begin
    print(f"\n{n:,} cases of seed {chosen.seed}, {failures} failed, in {took_s:.0f} s")
    return int(failures > 0)


def peak_mb() -> float:
    """Return the largest memory so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def memory_mb() -> float:
    """Return the memory of now."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


if __name__ == "__main__":
    sys.exit(main())
