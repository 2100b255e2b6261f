"""Public pictures of the sky: how many are read, found, accepted and right; nothing is fetched.

    OMP_NUM_THREADS=1 python docs/studies/public_skies.py FOLDER [--into OVERLAYS]

FOLDER holds clones of repositories by their names: vlad0x00/allsky-cloudiness-estimator,
ucalgary-srs/trex-imager-readfile, aaronwmorris/indi-allsky, LEX2016WoKaGru/pyclamster, UNISvalbard/KHO-starcalibration,
tudo-astroparticlephysics/all_sky_cloud_detection. Missing pictures are left out. Pictures of the night are given
without a calibration; right are cameras with the tilt of others' fits or with stars where others marked them by hand,
and suns near the places in the files' names, which others labelled by hand. Overlays show the named stars and a sun of
each folder.
"""

from __future__ import annotations

import argparse
import math
import re
from datetime import timedelta
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.common.errors import InputError, OutsideError
from sunarc.common.findings import FindingError
from sunarc.detection.values import Detection
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import pose_angles
from sunarc.public.star_files import StarImage, StarOptions, find_stars_blind
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.night import NightSky
from sunarc.sky.site import Site
from sunarc.sources.detect_files import detect_in_image
from sunarc.sources.files import read_image
from sunarc.sources.image_times import TimeRules

PETNICA, GILL = Site(latitude=44.2466, longitude=19.9306, altitude=190.0), Site(latitude=56.3767, longitude=-94.6437)
_PETNICA, _TREX = (
    "allsky-cloudiness-estimator/internals/sample_images",
    "trex-imager-readfile/python/tests/test_suite/data",
)
_LEX = "pyclamster/examples/images"
KHO = Site(latitude=78.148, longitude=16.043, altitude=520.0)
LA_PALMA = Site(latitude=28.7616, longitude=-17.8906, altitude=2200.0)
SOUTH_POLE = Site(latitude=-89.99, longitude=-63.45, altitude=2835.0)
_KHO, _CLOUDS = "KHO-starcalibration/Test_images", "all_sky_cloud_detection/tests/resources"
_MARKS = "KHO-starcalibration/Matlab/test_sonyA7Scalibration.m"


class Night(NamedTuple):
    """A picture of the night: its file, site, time in its name, size by which it is reduced, true tilt in degrees.

    marks: a Matlab script with azimuths and altitudes of stars, and where they are in the picture.
    """

    name: str
    file: str
    site: Site
    stem: str
    reduced: int = 1
    tilt_deg: float | None = None
    to_middle_s: float = 0.0
    marks: str | None = None


NIGHTS = (
    *(
        Night(f"Petnica, 1/{by}", f"{_PETNICA}/vladimir_IMG_0003.JPG", PETNICA, "20151203T042345Z", by, 1.0, 87.0)
        for by in (1, 2, 4)
    ),
    *(
        Night(
            f"TREx RGB, Gillam 2021, 1/{by}",
            f"{_TREX}/rgb/stream0.burst/20211030_060500_149606_gill_rgb-04_320ms_burst.png",
            GILL, "20211030T060500Z", by, 2.9,
        )
        for by in (1, 2)
    ),
    Night(
        "TREx RGB, Gillam 2020",
        f"{_TREX}/rgb/unstable/stream0.colour/20200508_060500_122643_gill_rgb-04_320ms_full.png",
        GILL, "20200508T060500Z",
    ),
    Night("TREx blue line", f"{_TREX}/blueline/20220308_0605_gill_blue-814_full.pgm", GILL, "20220308T060500Z"),
    Night("TREx near infrared", f"{_TREX}/nir/20220307_0605_gill_nir-216_8446.pgm", GILL, "20220307T060500Z"),
    *(
        Night(f"KHO Sony, 1/{by}", f"{_KHO}/LYR-Sony-111220_200933.jpg", KHO, "20201211T200933Z", by, marks=_MARKS)
        for by in (1, 2, 4, 6)
    ),
    Night("KHO Sony, 2021", f"{_KHO}/LYR-Sony-211121_170751.jpg", KHO, "20211121T170751Z"),
    Night("KHO Keo, 2020", f"{_KHO}/W8446B18_2020-12-11_20-09-36.img", KHO, "20201211T200936Z"),
    *(
        Night(f"MAGIC, {name}", f"{_CLOUDS}/magic_images/{name}.fits", LA_PALMA, f"magic{name}")
        for name in ("20180816_2101", "20180817_0055", "20180817_0341")
    ),
    *(
        Night(f"IceAct, {name}", f"{_CLOUDS}/iceact_images/{name}.fits", SOUTH_POLE, f"iceact-{name}")
        for name in ("starry", "cloudy")
    ),
)  # fmt: skip
SUNS = {
    "Wolf, labelled": f"{_LEX}/wolf/calibration",
    "Wettermast, labelled": f"{_LEX}/wettermast/calibration",
    "FE3, 1 September 2016": f"{_LEX}/lex/cam3",
    "FE4, 1 September 2016": f"{_LEX}/lex/cam4",
    "FE3, 29 August 2016": f"{_LEX}/lex/cam3_single",
    "Wolf": f"{_LEX}/wolf",
    "Wettermast, four pictures": f"{_LEX}/wettermast",
    "indi-allsky, clouds and moon": "indi-allsky/testing/blob_detection",
    "indi-allsky, examples": "indi-allsky/content",
}
"""Folders of pictures of the day and, of indi-allsky, of the night: no sun is in them."""
_LABEL = re.compile(r"sunrow(\d+)_suncol(\d+)")
_MARKED_V = 3.3
_LABEL_PX, _RIGHT_SIGMAS, _RIGHT_TILT_DEG = 2.0, 2.5, 0.3
"""1-sigma of a label by hand; distance from it in sigmas, and tilt from others', up to which a place is right."""


def night_row(night: Night, folder: Path, work: Path) -> tuple[str, StarImage | None]:
    """Return the row of a picture of the night, and its stars."""
    source = folder / night.file
    path = work / f"{night.stem}{source.suffix.lower()}"
    image = cv2.imread(str(source), cv2.IMREAD_UNCHANGED) if night.reduced > 1 else _raw(source)
    if image is None:
        path.write_bytes(source.read_bytes())
    else:
        shape = image.shape[1] // night.reduced, image.shape[0] // night.reduced
        cv2.imwrite(str(path.with_suffix(".png")), cv2.resize(image, shape, interpolation=cv2.INTER_AREA))
        path = path.with_suffix(".png")
    options = StarOptions(rules=TimeRules(None, timedelta(0)), to_middle_s=night.to_middle_s)
    result = find_stars_blind([path], night.site, options)
    (one,) = result.images
    right = ""
    if result.accepted and result.calibration is not None and night.tilt_deg is not None:
        tilt = pose_angles(result.calibration.camera.rotation_cam_enu).theta_zz_deg
        right = "yes" if abs(tilt - night.tilt_deg) < _RIGHT_TILT_DEG else f"no: tilt {tilt:.1f}"
    if result.accepted and result.calibration is not None and night.marks is not None:
        apart = _from_marks(folder / night.marks, result.calibration.camera, one.sky, night.reduced)
        right = f"{'yes' if apart < _RIGHT_SIGMAS * _LABEL_PX else 'no'}: {apart:.1f} px"
    detected = 0 if one.stars is None else len(one.stars)
    verdict = result.start.findings if result.calibration is None else result.calibration.verdict.findings
    why = "yes" if result.accepted else verdict[0].code
    counts = f"{int(one.stars is not None):4d} of 1  {detected:5d} {one.rows().size:5d}"
    row = f"{night.name:32s} {counts}  {why:28s} {right}"
    return row, one if result.accepted else None


def _raw(source: Path) -> NDArray[np.uint16] | None:
    """Return the picture of a Keo camera's file: a header of 60 bytes, two lengths, the size of a number; else None."""
    if source.suffix != ".img":
        return None
    content = source.read_bytes()
    columns, rows = np.frombuffer(content, "<u2", count=2, offset=60).tolist()
    return np.frombuffer(content, "<u2", count=rows * columns, offset=66).reshape(rows, columns).copy()


def _from_marks(script: Path, camera: Camera, sky: NightSky | None, reduced: int) -> float:
    """Return the median distance of a camera's stars from where others marked them, px of the whole picture.

    The directions printed at the marks are of a minute and a half before the picture: the star next to each counts.
    """
    if sky is None:
        return math.nan
    text = script.read_text()

    def column(name: str) -> NDArray[np.float64]:
        found = re.search(rf"{name}=\[(.*?)\]", text, re.DOTALL)
        cells = re.sub(r"\.\.\.[^\n]*\n", ",", "" if found is None else found[1]).split(",")
        parts = [re.findall(r"([\d.]+)(?:/(\d+))?", cell) for cell in cells if cell.strip()]
        return np.array([sum(float(number) / float(of or 1) for number, of in one) for one in parts])

    directions = direction_from_angles(zenith_deg=90.0 - column("starAlt"), azimuth_deg=column("starAz"))
    bright = sky.directions[sky.magnitude < _MARKED_V]
    near = directions @ bright.T
    found = near.max(axis=-1) > math.cos(math.radians(1.0))
    there = reduced * (project(camera, bright[near.argmax(axis=-1)]) + 0.5) - 0.5
    marked = np.stack([column("starCol"), column("starRow")], axis=-1) - 1.0
    return float(np.nanmedian(np.hypot(*(there - marked)[found].T)))


def sun_row(name: str, folder: Path, into: Path | None) -> str:
    """Return the row of a folder of pictures of the day."""
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in {".jpg", ".jpeg", ".png"})
    read = accepted = right = labelled = 0
    found: list[tuple[Path, Detection]] = []
    for path in files:
        try:
            one = detect_in_image(read_image(path))
        except (FindingError, InputError, OutsideError):
            continue
        read, accepted = read + 1, accepted + one.accepted
        label = _LABEL.search(path.name)
        if one.accepted and one.x_px is not None and one.y_px is not None:
            found.append((path, one))
            if label is not None:
                row, column = map(int, label.groups())
                labelled += 1
                limit = _RIGHT_SIGMAS * math.hypot(one.sigma_px or 0.0, _LABEL_PX)
                right += math.hypot(one.x_px - column, one.y_px - row) < limit
    if into is not None and found:
        path, one = found[len(found) // 2]
        _overlay(path, np.array([[one.x_px, one.y_px]], dtype=np.float64), into / f"{name.replace(' ', '-')}.png")
    judged = f"{right} of {labelled} within {_RIGHT_SIGMAS:g} sigma" if labelled else ""
    return f"{name:32s} {read:4d} of {len(files):<3d} {accepted:5d} suns   {judged}"


def _overlay(source: Path, pixels: NDArray[np.float64], target: Path) -> None:
    """Write a picture with circles around places (n, 2), px, at most 1,200 px wide."""
    image = cv2.imread(str(source))
    if image is None:
        return
    scale = min(1.0, 1200.0 / image.shape[1])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    for x, y in (scale * pixels).round().astype(int).tolist():
        cv2.circle(small, (x, y), 9, (0, 255, 255), 1, cv2.LINE_AA)
    cv2.imwrite(str(target), small)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="public_skies.py", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--into", type=Path, help="folder of overlays")
    asked = parser.parse_args()
    work = Path(asked.into or ".") / "night"
    work.mkdir(parents=True, exist_ok=True)
    print(f"{'pictures':32s} read       found named  accepted, or why not         right")
    for night in NIGHTS:
        if not (asked.folder / night.file).is_file():
            continue
        row, stars = night_row(night, asked.folder, work)
        print(row, flush=True)
        if stars is not None and stars.matches is not None and stars.stars is not None and asked.into is not None:
            named = stars.stars.pixels[stars.matches.detection]
            _overlay(work / Path(stars.file).name, named, asked.into / f"{night.name.replace('/', '-of-')}.png")
    for name, place in SUNS.items():
        if (asked.folder / place).is_dir():
            print(sun_row(name, asked.folder / place, asked.into), flush=True)


if __name__ == "__main__":
    main()
