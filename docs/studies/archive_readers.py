"""What each reader of `sunarc reanalyse` costs: bytes and processor time of an image, and what looking at it costs.

    python docs/studies/archive_readers.py [--side 1448] [--images 16]

Makes so many photographs of so many pixels a side (1448 are 2 MP), keeps them as each kind of archive does, and reads
them as a worker does, in one process. Prints, for each: MB and processor seconds an image, images a second of one core
with the detector, and MB/s that the storage has to give to one core. The second table has the detector alone: without a
prediction, and with one that is right.
"""

from __future__ import annotations

import argparse
import io
import tarfile
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import cv2
import numpy as np
from astropy.io import fits
from netCDF4 import Dataset

from sunarc.detection.values import Expectation
from sunarc.lab.simulation.made_archive import photograph
from sunarc.sources.detect_files import detect_in_image
from sunarc.sources.image_files import images_in
from sunarc.sources.sources import open_source

_QUALITY = 90


class Archive(NamedTuple):
    """An archive: its name in the table, its address, the files and numbers of its images, and its size."""

    name: str
    address: str
    images: list[tuple[str, list[int]]]
    n_bytes: int


def main() -> None:
    """Make the archives, read them, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--side", type=int, default=1448)
    parser.add_argument("--images", type=int, default=16)
    asked = parser.parse_args()
    cv2.setNumThreads(1)
    rng = np.random.default_rng(18)
    places = list(rng.uniform(0.3 * asked.side, 0.7 * asked.side, (asked.images, 2)))
    pictures = [photograph(asked.side, place, rng) for place in places]
    searched, predicted = (_looking(pictures, places, known=known) for known in (False, True))
    print("| archive | MB an image | reading, s | images/s of a core | MB/s to a core |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory(prefix="readers-") as folder:
        for made in _archives(pictures, Path(folder)):
            seconds = _reading(made, asked.images)
            megabytes = made.n_bytes / asked.images / 1e6
            rate = 1.0 / (seconds + searched)
            print(f"| {made.name} | {megabytes:.2f} | {seconds:.3f} | {rate:.1f} | {rate * megabytes:.1f} |")
    print(f"\ndetector: {searched:.3f} s without a prediction, {predicted:.3f} s with one")


def _looking(pictures: Sequence[Any], places: Sequence[Any], *, known: bool) -> float:
    """Return the processor time of the detector for an image, s."""
    expected = [Expectation(x_px=x, y_px=y, uncertainty_px=2.0) if known else None for x, y in places]
    detect_in_image(pictures[0], method="paper", expectation=expected[0])
    began = process_time()
    for picture, one in zip(pictures, expected, strict=True):
        detect_in_image(picture, method="paper", expectation=one)
    return (process_time() - began) / len(pictures)


def _reading(made: Archive, n: int) -> float:
    """Return the processor time of reading and decoding an image, s."""
    source, seen = open_source(made.address), 0
    next(images_in(source, *made.images[0], size=None))  # imports, and the archive's directory
    began = process_time()
    for file, numbers in made.images:
        seen += sum(isinstance(image, np.ndarray) for _, image in images_in(source, file, numbers, size=None))
    spent = process_time() - began
    if seen != n:
        raise SystemExit(f"{made.name}: {n - seen} images could not be read")
    return spent / n


def _archives(pictures: Sequence[Any], folder: Path) -> Iterator[Archive]:
    """Yield archives of every kind with the same pictures in them."""
    jpeg = _encoded(pictures, ".jpg", [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    yield _in_folder("JPEG in a folder", jpeg, folder / "jpeg")
    yield _single("JPEG in a zip", jpeg, folder / "jpeg.zip", _zip)
    yield _single("JPEG in a tar", jpeg, folder / "jpeg.tar", lambda path, files: _tar(path, files, "w"))
    yield _single("JPEG in a tar.gz", jpeg, folder / "jpeg.tgz", lambda path, files: _tar(path, files, "w:gz"))
    remote = _in_folder("JPEG by fsspec (local)", jpeg, folder / "remote")
    yield remote._replace(address=f"file://{remote.address}")
    deep = [image.astype(np.uint16) * 257 for image in pictures]
    yield _in_folder("PNG", _encoded(pictures, ".png"), folder / "png")
    yield _in_folder("PNG, 16 bits", _encoded(deep, ".png"), folder / "png16")
    yield _in_folder("TIFF, 16 bits", _encoded(deep, ".tif"), folder / "tif")
    yield _in_folder("JPEG 2000, 16 bits", _encoded(deep, ".jp2"), folder / "jp2")
    grey = [image[..., 1] for image in deep]
    yield _in_folder("FITS, 16 bits, mono", {f"{n}.fits": _fits(one) for n, one in enumerate(grey)}, folder / "fits")
    yield _in_one_file("NetCDF, 16 bits, mono", folder / "day.nc", len(grey), lambda path: _netcdf(path, grey))
    yield _in_one_file("MP4", folder / "day.mp4", len(pictures), lambda path: _video(path, pictures))


def _encoded(pictures: Sequence[Any], suffix: str, how: Sequence[int] = ()) -> dict[str, bytes]:
    return {f"{n:04d}{suffix}": cv2.imencode(suffix, one, how)[1].tobytes() for n, one in enumerate(pictures)}


def _in_folder(name: str, files: dict[str, bytes], folder: Path) -> Archive:
    folder.mkdir()
    for file, content in files.items():
        (folder / file).write_bytes(content)
    return Archive(name, str(folder), [(file, [0]) for file in files], sum(map(len, files.values())))


def _single(name: str, files: dict[str, bytes], path: Path, write: Callable[[Path, dict[str, bytes]], None]) -> Archive:
    write(path, files)
    return Archive(name, str(path), [(file, [0]) for file in files], path.stat().st_size)


def _in_one_file(name: str, path: Path, n: int, write: Callable[[Path], None]) -> Archive:
    write(path)
    return Archive(name, str(path), [(path.name, list(range(n)))], path.stat().st_size)


def _zip(path: Path, files: dict[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)


def _tar(path: Path, files: dict[str, bytes], mode: Any) -> None:  # noqa: ANN401 - of `tarfile`
    with tarfile.open(path, mode) as archive:
        for name, content in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))


def _fits(image: Any) -> bytes:  # noqa: ANN401 - an array
    file = io.BytesIO()
    fits.PrimaryHDU(image).writeto(file)
    return file.getvalue()


def _netcdf(path: Path, images: Sequence[Any]) -> None:
    with Dataset(path, "w") as data:
        for name, size in (("time", len(images)), ("y", images[0].shape[0]), ("x", images[0].shape[1])):
            data.createDimension(name, size)
        time = data.createVariable("time", "f8", ("time",))
        time.units = "seconds since 2013-05-13"
        time[:] = np.arange(len(images))
        light = data.createVariable("image", "u2", ("time", "y", "x"), zlib=True, chunksizes=(1, *images[0].shape))
        light[:] = np.stack(images)


def _video(path: Path, pictures: Sequence[Any]) -> None:
    height, width = pictures[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, (width, height))
    for one in pictures:
        writer.write(one)
    writer.release()


if __name__ == "__main__":
    main()
