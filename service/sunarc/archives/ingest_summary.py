"""Summary of a run over a folder: counts, reasons, and a sheet with examples of each verdict."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from sunarc.common.array_types import Image
from sunarc.common.errors import disk_errors
from sunarc.common.findings import Finding
from sunarc.imager.archive.sightings import FileSighting
from sunarc.imager.live.folder_nights import NightOutcome
from sunarc.imaging.preview import preview
from sunarc.sources.image_files import read_one_image
from sunarc.sources.index import ArchiveImage, Failure
from sunarc.sources.sources import open_source


@dataclass(frozen=True, slots=True, kw_only=True)
class IngestSummary:
    """Counts of a folder's images.

    Attributes
    ----------
    accepted, rejected : images read in this run, by whether a fit may use their sighting.
    stacked : images read in this run whose sighting is that of another image of the same time.
    known : images that were in the archive before, and were left as they were.
    by_verdict : all images of the folder in the archive, those known before among them, by the verdict on them.
    skipped : images that were left out, with the reason.
    contact_sheet : picture with examples of each verdict; None where there is no image.
    camera_findings : why no camera could predict the sun in some images, and what of it has to be set.
    nights : nights whose images were read in this run.
    nights_known : images of nights that were read before.
    """

    accepted: int
    rejected: int
    stacked: int
    known: int
    by_verdict: Mapping[str, int]
    skipped: tuple[Failure, ...]
    contact_sheet: Path | None
    camera_findings: tuple[Finding, ...] = ()
    nights: tuple[NightOutcome, ...] = ()
    nights_known: int = 0

    @property
    def by_reason(self) -> dict[str, int]:
        """Images that were left out, by the code of the reason."""
        return dict(Counter(one.finding.code for one in self.skipped).most_common())

    def as_json(self) -> dict[str, Any]:
        """Return the JSON object of `sunarc ingest --json`."""
        return {
            "accepted": self.accepted,
            "rejected": self.rejected,
            "stacked": self.stacked,
            "known": self.known,
            "skipped": len(self.skipped),
            "by_verdict": dict(self.by_verdict),
            "by_reason": self.by_reason,
            "contact_sheet": None if self.contact_sheet is None else str(self.contact_sheet),
            "camera_findings": [finding.as_json() for finding in self.camera_findings],
            "nights": [night.as_json() for night in self.nights],
            "nights_known": self.nights_known,
            "files_skipped": [
                {"file": one.file, **one.finding.as_json(), "reason": one.finding.text} for one in self.skipped
            ],
        }


_EXAMPLES = 5
TILE_PX = 220
TITLE_PX = 30
_CROP_RADII = 6.0
"""Half a crop's side, in radii of the sun that was found."""
_LEAST_CROP_PX = 24
ACCEPTED, REJECTED, _TEXT = (0, 200, 0), (0, 140, 255), (230, 230, 230)

_Picture = np.ndarray[Any, np.dtype[np.uint8]]


def write_contact_sheet(found: Mapping[ArchiveImage, FileSighting], target: Path) -> None:
    """Write a PNG with a row of pictures for each verdict, the most frequent first.

    An example is the whole image with a mark, and next to it a crop around the mark at its own brightness. They are
    spread evenly over the folder.

    Raises
    ------
    OutsideError : the file cannot be written.
    """
    by_verdict: dict[str, list[ArchiveImage]] = {}
    for image, sighting in found.items():
        by_verdict.setdefault(sighting.verdict, []).append(image)
    rows = [
        _draw_row(verdict, images, found)
        for verdict, images in sorted(by_verdict.items(), key=lambda one: -len(one[1]))
    ]
    encoded = cv2.imencode(".png", np.vstack(rows))[1]
    with disk_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(encoded.tobytes())


def _draw_row(verdict: str, images: Sequence[ArchiveImage], found: Mapping[ArchiveImage, FileSighting]) -> _Picture:
    some = np.unique(np.linspace(0, len(images) - 1, _EXAMPLES).astype(int))
    tiles = [_draw_example(images[index], found[images[index]]) for index in some]
    row = np.zeros((TITLE_PX + TILE_PX, 2 * TILE_PX * _EXAMPLES, 3), dtype=np.uint8)
    _write_text(row, f"{verdict}: {len(images)}", (6, TITLE_PX - 9), scale=0.7)
    for number, tile in enumerate(tiles):
        row[TITLE_PX:, 2 * TILE_PX * number : 2 * TILE_PX * (number + 1)] = tile
    return row


def _draw_example(shown: ArchiveImage, sighting: FileSighting) -> _Picture:
    """Return one example, (tile, 2 tiles, 3); an image that is gone meanwhile leaves it dark."""
    tile = np.zeros((TILE_PX, 2 * TILE_PX, 3), dtype=np.uint8)
    image = read_one_image(open_source(shown.address), shown.file, shown.number)
    if isinstance(image, Finding):
        return tile
    small, shrink = _fit_to_tile(_convert_to_colours(image))
    if sighting.x_px is not None and sighting.y_px is not None:
        at = round(shrink * sighting.x_px), round(shrink * sighting.y_px)
        colour = ACCEPTED if sighting.accepted else REJECTED
        cv2.drawMarker(small, at, colour, markerType=cv2.MARKER_CROSS, markerSize=18, thickness=1)
        crop = _draw_crop(image, sighting)
        tile[: crop.shape[0], TILE_PX : TILE_PX + crop.shape[1]] = crop
    tile[: small.shape[0], : small.shape[1]] = small
    _write_text(tile, shown.key[2][-34:], (3, TILE_PX - 5), scale=0.36)
    return tile


def _draw_crop(image: Image, sighting: FileSighting) -> _Picture:
    """Return the surroundings of a sighting, enlarged, its centre and radius marked."""
    x, y, radius = float(sighting.x_px or 0.0), float(sighting.y_px or 0.0), sighting.radius_px or 0.0
    half = max(round(_CROP_RADII * radius), _LEAST_CROP_PX)
    left, top = max(0, round(x) - half), max(0, round(y) - half)
    part = image[top : round(y) + half + 1, left : round(x) + half + 1]
    if part.size == 0:
        return np.zeros((1, 1, 3), dtype=np.uint8)
    enlarged, scale = _fit_to_tile(_convert_to_colours(part))
    centre = round(scale * (x - left)), round(scale * (y - top))
    colour = ACCEPTED if sighting.accepted else REJECTED
    cv2.drawMarker(enlarged, centre, colour, markerType=cv2.MARKER_CROSS, markerSize=9, thickness=1)
    if radius > 0.0:
        cv2.circle(enlarged, centre, round(scale * radius), colour, 1)
    return enlarged


def _fit_to_tile(picture: _Picture) -> tuple[_Picture, float]:
    """Return a picture as large as a tile holds, and by how much it was enlarged."""
    scale = TILE_PX / max(picture.shape[:2])
    size = max(1, round(scale * picture.shape[1])), max(1, round(scale * picture.shape[0]))
    method = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_NEAREST
    return np.ascontiguousarray(cv2.resize(picture, size, interpolation=method), dtype=np.uint8), scale


def _convert_to_colours(image: Image) -> _Picture:
    """Return an image as 8 bit colours, blue first."""
    if image.ndim == 3:
        return (image if image.dtype == np.uint8 else image // 257).astype(np.uint8)
    grey = image if image.dtype == np.uint8 else preview(image)
    return cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR).astype(np.uint8)


def _write_text(picture: _Picture, text: str, at: tuple[int, int], *, scale: float) -> None:
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, (0, 0, 0), 3, cv2.LINE_AA)
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, _TEXT, 1, cv2.LINE_AA)
