"""The detector for ordinary photographs on real images with the suns labelled by hand.

    python docs/studies/photographs.py --images DIR --labels labels.csv [--static] [--verbose]

labels.csv: `file,x_px,y_px`, the name of each image below DIR and the centre of its sun; both left empty where it shows
none. `--static` masks what stands still in the series first (images over hours). Prints, over the images: how many suns
were accepted, the distance from the labels, its square over the stated variance (per axis, with the labels' own error),
acceptances beyond 4 sigma, and the processor time of an image with its decoding. No image is kept.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from sunarc.common.array_types import BoolArray, Image
from sunarc.detection.photo.ordinary_image import Photo, detect_sun_in_photo
from sunarc.detection.photo.plateau import static_mask
from sunarc.detection.values import Detection
from sunarc.sources.files import read_image

_FULL_SCALE = {"uint8": 255, "uint16": 65535}
_REDUCED_PX = 640  # smaller side of the images of which the mask is made


class Label(NamedTuple):
    """The centre of the sun in a file, px; None where there is none."""

    file: Path
    place: tuple[float, float] | None


def read_labels(folder: Path, path: Path) -> list[Label]:
    """Return the labels of a file in the order of their names."""
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    labels = [
        Label(folder / row["file"], (float(row["x_px"]), float(row["y_px"])) if row["x_px"] else None) for row in rows
    ]
    return sorted(labels, key=lambda label: label.file.name)


def mask_of(labels: list[Label]) -> BoolArray | None:
    """Return what stands still in 24 of the images, reduced."""
    some = labels[:: max(1, len(labels) // 24)]
    reduced = list[Image]()
    for label in some:
        image = read_image(label.file)
        scale = min(1.0, _REDUCED_PX / min(image.shape[:2]))
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        reduced.append(small.astype(np.uint8) if image.dtype == np.uint8 else small.astype(np.uint16))
    return static_mask(reduced, full_scale=_FULL_SCALE[str(reduced[0].dtype)])


def report(labels: list[Label], found: list[Detection], seconds: float, label_sigma_px: float) -> str:
    """Return the lines of the result."""
    pairs = [(label, each) for label, each in zip(labels, found, strict=True) if each.accepted]
    suns = [(label.place, each) for label, each in pairs if label.place is not None]
    error = np.array([math.hypot((d.x_px or 0.0) - p[0], (d.y_px or 0.0) - p[1]) for p, d in suns])
    sigma = np.array([math.hypot(d.sigma_px or 0.0, label_sigma_px) for _, d in suns])
    lines = [
        f"{len(labels)} images, {sum(label.place is not None for label in labels)} suns labelled",
        f"accepted {len(pairs)}, of them {len(pairs) - len(suns)} without a sun",
        f"verdicts {dict(Counter(each.findings[0].code for each in found))}",
        f"processor {seconds / max(len(labels), 1):.2f} s an image",
    ]
    if suns:
        lines.append(
            f"error: median {np.median(error):.2f} px, largest {error.max():.1f} px; stated sigma: median "
            f"{np.median([d.sigma_px for _, d in suns]):.2f} px; chi² {np.mean((error / sigma) ** 2) / 2.0:.2f}; "
            f"beyond 4 sigma {np.count_nonzero(error > 4.0 * sigma)}"
        )
    return "\n".join(lines)


def main() -> None:
    """Look at the images and print the result."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, required=True)
    parser.add_argument("--labels", type=Path, required=True)
    parser.add_argument("--label-sigma", type=float, default=2.0, help="1-sigma per axis of the labels, px")
    parser.add_argument("--static", action="store_true")
    parser.add_argument("--verbose", action="store_true")
    arguments = parser.parse_args()
    labels = read_labels(arguments.images, arguments.labels)
    static = mask_of(labels) if arguments.static else None
    found, begin = [], time.process_time()
    for label in labels:
        image = read_image(label.file)
        found.append(detect_sun_in_photo(Photo(image, _FULL_SCALE[str(image.dtype)], static=static)))
    seconds = time.process_time() - begin
    if arguments.verbose:
        for label, each in zip(labels, found, strict=True):
            place = "" if each.x_px is None else f"{each.x_px:.1f},{each.y_px:.1f} ± {each.sigma_px:.1f} px"
            sys.stdout.write(f"{label.file.name}: {place} {each.verdict}: {each.reason}\n")
    sys.stdout.write(report(labels, found, seconds, arguments.label_sigma) + "\n")


if __name__ == "__main__":
    main()
