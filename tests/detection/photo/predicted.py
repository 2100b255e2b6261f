"""The search about a predicted place against that of the whole image: what they answer, and what they cost.

    python -m tests.detection.photo.predicted --images 20 --side 1448 [--folder DIR]

renders so many images of each kind of the stand-ins (1448 px a side are 2 MP), or reads the JPEG files of a folder, and
prints: how many were accepted by the whole image and by the window, in how many the verdict is the same (a sun
elsewhere is hidden to the window), the largest distance between positions that both accept, and processor time of an
image in ms: decoding with its checks, the whole image, the window, and the window over the decoding.

Suns of stand-ins are predicted 2 px off at a stated 2 px. Where there is none, and in files, the prediction is at what
the whole image shows, accepted or not, and as often anywhere.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from time import process_time
from typing import NamedTuple

import cv2
import numpy as np
from tests.detection.photo.facts import KINDS, SUNLESS, Picture, sun_photo, sunless_photo

from sunarc.detection.photo.candidates import candidates_in, whole_part
from sunarc.detection.photo.ordinary_image import Photo, choose_candidate, detect_sun_in_photo
from sunarc.detection.values import Detection, Expectation, Verdict
from sunarc.sources.image_files import checked_image

Place = tuple[float, float]
_SIGMA_PX = 2.0


class Answer(NamedTuple):
    """What a search says: its verdict and place; "hidden" without one."""

    verdict: Verdict
    place: Place | None
    sigma_px: float | None = None


class Compared(NamedTuple):
    """Answers by the whole image and by the window, and the processor time of decoding and of both, s."""

    whole: Answer
    window: Answer
    seconds: tuple[float, float, float] = (0.0, 0.0, 0.0)


def by_whole(image: Picture, expectation: Expectation) -> Answer:
    """Return what the whole image says of a prediction: the former search, its candidates of all the image judged."""
    seen = candidates_in(whole_part(image, static=None, bayer=None), full_scale=255)
    if not seen:
        return Answer("hidden", None)
    best = choose_candidate(seen, expectation)
    return Answer(best.verdict, (best.seen.rim.x, best.seen.rim.y), best.seen.sigma_px)


def by_window(image: Picture, expectation: Expectation) -> Answer:
    """Return what the window about a prediction says."""
    found = detect_sun_in_photo(Photo(image, 255), expectation=expectation, elsewhere=False)
    place = None if found.x_px is None or found.y_px is None else (found.x_px, found.y_px)
    return Answer(found.verdict, place, found.sigma_px)


def compared(image: Picture, place: Place, rng: np.random.Generator) -> Compared:
    """Return what both searches say of a prediction that is off by its sigma."""
    x, y = (value + float(rng.normal(0.0, _SIGMA_PX)) for value in place)
    expectation = Expectation(x_px=x, y_px=y, uncertainty_px=_SIGMA_PX)
    return Compared(by_whole(image, expectation), by_window(image, expectation))


def stand_ins(kind: str, images: int, side: int, rng: np.random.Generator) -> Iterator[tuple[Picture, Place]]:
    """Yield images of a kind, with or without a sun, and a place to predict."""
    for number in range(images):
        if kind in KINDS:
            yield sun_photo(KINDS[kind], rng, size=side)
        else:
            image = sunless_photo(kind, rng, size=side)
            yield image, _place(detect_sun_in_photo(Photo(image, 255)), side, rng, anywhere=number % 2 == 1)


def files_in(folder: Path, images: int, rng: np.random.Generator, *, anywhere: bool) -> Iterator[tuple[Picture, Place]]:
    """Yield images of a folder, spread over it, and a place to predict."""
    files = sorted(folder.glob("*.jpg"))
    for file in files[:: max(1, len(files) // images)]:
        image = checked_image(file.read_bytes(), file.name).astype(np.uint8, copy=False)
        found = detect_sun_in_photo(Photo(image, 255))
        yield image, _place(found, min(image.shape[:2]), rng, anywhere=anywhere)


def _place(found: Detection, side: int, rng: np.random.Generator, *, anywhere: bool) -> Place:
    if found.x_px is not None and found.y_px is not None and not anywhere:
        return found.x_px, found.y_px
    angle, far = rng.uniform(0.0, 2.0 * math.pi), 0.4 * side * math.sqrt(rng.uniform(0.0, 1.0))
    return 0.5 * side + far * math.cos(angle), 0.5 * side + far * math.sin(angle)


def _timed(image: Picture, one: Compared, place: Place) -> Compared:
    done, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])
    assert done
    expectation = Expectation(x_px=place[0] + 1.0, y_px=place[1] - 1.0, uncertainty_px=_SIGMA_PX)
    works: tuple[Callable[[], object], ...] = (
        lambda: checked_image(encoded.tobytes(), "image.jpg"),
        lambda: by_whole(image, expectation),
        lambda: by_window(image, expectation),
    )
    decoding, whole, window = (min(_seconds(work) for _ in range(3)) for work in works)
    return one._replace(seconds=(decoding, whole, window))


def _seconds(work: Callable[[], object]) -> float:
    began = process_time()
    work()
    return process_time() - began


def distance_px(one: Compared) -> float:
    """Return how far both places are from one another, where both accept; NaN elsewhere."""
    if one.whole.place is None or one.window.place is None or not (one.whole.verdict == one.window.verdict == "clear"):
        return math.nan
    return math.dist(one.whole.place, one.window.place)


def says_the_same(one: Compared) -> bool:
    """Return whether both verdicts are one; what is elsewhere is a reflection to the one and hidden to the other."""
    elsewhere = {"reflection", "hidden"}
    return one.whole.verdict == one.window.verdict or {one.whole.verdict, one.window.verdict} == elsewhere


def _row(title: str, given: Iterator[tuple[Picture, Place]], rng: np.random.Generator) -> str:
    rows = [_timed(image, compared(image, place, rng), place) for image, place in given]
    accepted = [
        sum(one.verdict == "clear" for one in side) for side in ([r.whole for r in rows], [r.window for r in rows])
    ]
    same = sum(one.whole.verdict == one.window.verdict for one in rows)
    far = [d for one in rows if math.isfinite(d := distance_px(one))]
    decoding, whole, window = (1e3 * float(np.mean([one.seconds[n] for one in rows])) for n in range(3))
    return (
        f"| {title} | {accepted[0]} | {accepted[1]} | {same} of {len(rows)} | {max(far, default=math.nan):.2g} | "
        f"{decoding:.1f} | {whole:.1f} | {window:.1f} | {window / decoding:.1f} |\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=20)
    parser.add_argument("--side", type=int, default=1448)
    parser.add_argument("--folder", type=Path)
    asked, rng = parser.parse_args(), np.random.default_rng(18)
    cv2.setNumThreads(1)
    if asked.folder is not None:
        for anywhere in (False, True):
            given = files_in(asked.folder, asked.images, rng, anywhere=anywhere)
            sys.stdout.write(_row("anywhere" if anywhere else "at what is there", given, rng))
        return
    for kind in (*KINDS, *SUNLESS):
        sys.stdout.write(_row(kind, stand_ins(kind, asked.images, asked.side, rng), rng))
        sys.stdout.flush()


if __name__ == "__main__":
    main()
