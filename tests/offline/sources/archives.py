"""Small archives of every kind, with the same files in them."""

from __future__ import annotations

import io
import tarfile
import zipfile
from pathlib import Path

import cv2
import numpy as np

NAMES = ("day/20130513T183000Z.png", "day/20130513T184000Z.jpg")
GREY = np.arange(20 * 24, dtype=np.uint8).reshape(20, 24)
DEEP = np.arange(20 * 24, dtype=np.uint16).reshape(20, 24) * 100


def encoded(image: cv2.typing.MatLike, suffix: str) -> bytes:
    lossless = [cv2.IMWRITE_JPEG2000_COMPRESSION_X1000, 1000] if suffix == ".jp2" else []
    return cv2.imencode(suffix, image, lossless)[1].tobytes()


def contents() -> dict[str, bytes]:
    return {name: encoded(GREY, name[-4:]) for name in NAMES} | {"notes.txt": b"no image"}


def folder_of(files: dict[str, bytes], folder: Path) -> Path:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def zip_of(files: dict[str, bytes], path: Path) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def tar_of(files: dict[str, bytes], path: Path, compression: str = "") -> Path:
    with tarfile.open(path, f"w:{compression}") as archive:  # type: ignore[call-overload]
        for name, content in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
    return path
