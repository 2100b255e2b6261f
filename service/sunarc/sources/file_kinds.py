"""Kinds of files that hold images: one table of endings, readers and extras; files that programs derive from images."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Literal, NamedTuple

from sunarc.common.findings import Finding

Kind = Literal["picture", "netpbm", "fits", "netcdf", "video"]


class FileKind(NamedTuple):
    """Files of one kind."""

    label: str
    """As documents and messages name them."""
    kind: Kind
    endings: tuple[str, ...]
    """Lower case, the most usual one first."""
    reader: str
    """Library that decodes them."""
    extra: str | None
    """Extra of the package that brings the library; None for the base."""
    example: str
    """Name of such a file."""


FILE_KINDS = (
    FileKind("JPEG", "picture", (".jpg", ".jpeg"), "OpenCV", None, "image-20130513123000.jpg"),
    FileKind("PNG", "picture", (".png",), "OpenCV", None, "20130513T123000Z.png"),
    FileKind("TIFF", "picture", (".tif", ".tiff"), "OpenCV", None, "20130513123000.tiff"),
    FileKind("JPEG 2000", "picture", (".jp2",), "OpenCV", None, "20130513123000.jp2"),
    FileKind("BMP", "picture", (".bmp", ".bmp.gz"), "OpenCV", None, "20130513123000.bmp"),
    FileKind("WebP", "picture", (".webp", ".webp.gz"), "OpenCV", None, "20130513_123000.webp"),
    FileKind(
        "PGM and PPM, also of many images (THEMIS, REGO, TREx)",
        "netpbm",
        (".pgm", ".ppm", ".pnm", ".pgm.gz", ".ppm.gz", ".pnm.gz"),
        "OpenCV",
        None,
        "20130513_1230_gill_themis19_full.pgm.gz",
    ),
    FileKind(
        "FITS, also of compressed tiles",
        "fits",
        (".fits", ".fit", ".fts", ".fits.gz", ".fit.gz", ".fts.gz", ".fz"),
        "astropy",
        "fits",
        "FF_HR0001_20130513_123000_250_0000000.fits",
    ),
    FileKind(
        "NetCDF-4, and HDF5 of TREx",
        "netcdf",
        (".nc", ".nc4", ".h5"),
        "h5py",
        "netcdf",
        "20211030_0605_gill_rgb-04_full.h5",
    ),
    FileKind("video", "video", (".mp4", ".m4v", ".mov", ".avi"), "OpenCV", None, "allday.mp4"),
)
ONE_IMAGE = frozenset[Kind]({"picture", "netpbm", "fits"})
"""Kinds of files that are read whole: one image, or some minutes of them."""
_BY_ENDING = {ending: one for one in FILE_KINDS for ending in one.endings}
_LONGEST_FIRST = sorted(_BY_ENDING, key=len, reverse=True)

UNREAD = {
    **dict.fromkeys((".heic", ".heif"), ("HEIC", "convert it with heif-convert FILE.heic FILE.png (libheif-examples)")),
    ".avif": ("AVIF", "convert it to PNG"),
    ".gif": ("GIF", "convert it to PNG"),
    **dict.fromkeys(
        (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2"),
        ("raw image of a camera", "convert it without correction of the lens: dcraw -T -4 FILE"),
    ),
    ".cal": ("RMS platepar", "give the FF files of the station; its plate solution is not taken over"),
    ".sav": ("IDL save file", "give the images; a skymap is not taken over"),
    ".cdf": ("CDF", "give the images as PGM, PNG or FITS"),
}  # fmt: skip
"""Endings of files that are named as not read: their kind, and the remedy."""


def find_kind(name: str) -> Kind | None:
    """Return the kind of a file by its name; None for one that holds no images that are read."""
    ending = listed_ending(name)
    return _BY_ENDING[ending].kind if ending in _BY_ENDING else None


def listed_ending(name: str) -> str:
    """Return the ending of a file's name as it is listed here, else its last suffix; lower case, with the point."""
    lower = PurePosixPath(name).name.lower()
    return next((one for one in _LONGEST_FIRST if lower.endswith(one)), PurePosixPath(lower).suffix)


def path_stem(name: str) -> str:
    """Return a path without the ending of its file."""
    return name[: len(name) - len(listed_ending(name))]


def unread_finding(name: str) -> Finding | None:
    """Return why a file of images, or of a camera, is not read; None for other files."""
    label, action = UNREAD.get(listed_ending(name), ("", ""))
    return Finding("file_kind_not_read", {"kind": label, "action": action}) if label else None


_ISO_BRANDS = {
    b"heic": ".heic",
    b"heix": ".heic",
    b"mif1": ".heic",
    b"msf1": ".heic",
    b"hevc": ".heic",
    b"avif": ".avif",
}
"""Major brands of still images in ISO media files (ISO/IEC 23008-12, annex B)."""


def unread_content(head: bytes) -> Finding | None:
    """Return why content is not read that is HEIC or AVIF whatever its file is called; None for other content."""
    return unread_finding("a" + _ISO_BRANDS[head[8:12]]) if head[4:8] == b"ftyp" and head[8:12] in _ISO_BRANDS else None


DERIVED_FOLDERS = frozenset(
    {"thumbnails", "thumbs", "keogram", "keograms", "startrails", "timelapse", "panoramas", "@eadir", "lost+found"}
)
"""Subfolders that allsky, indi-allsky, file servers and file systems make in the images' folder."""
_DERIVED_NAME = re.compile(
    r"(?:allsky-)?(?:keogram|startrails?|(?:mini-?)?timelapse|panorama\w*|thumbnail|thumb)[-_.]"
    r"|allsky-\d{8}\."
    r"|.*_(?:captured|DETECTED)_(?:stack|thumbs)|.*_(?:stack_\d+_meteors|fieldsums|CAPTURED_thumbs)",
    re.IGNORECASE,
)
"""Names of the files that AllskyTeam's allsky, indi-allsky and RMS make of a night's images."""


def is_derived(name: str) -> bool:
    """Return whether a file, by its path below its source, is one that a program made of images, or is hidden."""
    *folders, last = PurePosixPath(name).parts or ("",)
    if last.startswith(".") or any(part.startswith(".") or part.lower() in DERIVED_FOLDERS for part in folders):
        return True
    return _DERIVED_NAME.match(last) is not None


def without_derived(paths: Sequence[Path]) -> list[Path]:
    """Return files without those that programs made of images, by folder and name; all where there is no other."""
    kept = [one for one in paths if not is_derived(f"{one.absolute().parent.name.lstrip('.')}/{one.name}")]
    return kept or list(paths)
