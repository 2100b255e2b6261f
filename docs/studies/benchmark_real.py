"""The benchmark's real part: published sun tracks, part of whose sightings are held out; the sun itself is the truth.

    python docs/studies/benchmark_real.py [--tracks FOLDER] [--base URL] --out ROUND

A track is taken from FOLDER, as `NAME.csv` with `time_utc,x_px,y_px`, or fetched from where its authors published it;
one that is not to be had is skipped with the reason. Each gives three cases: the morning is given and the afternoon
asked for, the reverse, and every other hour. What is asked for is a detection, with an error of some tenths of a px.

Licences: pyclamster is GPL-3.0; its track is read on the user's machine, and no part of it is passed on.
"""

from __future__ import annotations

import argparse
import io
import pickle
import sys
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.model.sightings import Sightings
from sunarc.common.errors import InputError
from sunarc.formats.csv_files import read_sightings
from sunarc.lab.studies.benchmark_cases import BenchmarkCase, BenchmarkTruth, degrees_to_nearest
from sunarc.lab.studies.benchmark_files import write_round
from sunarc.optics.projections import Projection
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.site import Site
from sunarc.sky.sun import hour_angle, sun_directions

FloatArray = NDArray[np.float64]
_MOUNT_DEG, _TIMEOUT_S, _LARGEST = 5.0, 20.0, 10_000_000
_BESIDE_S = 1200.0


@dataclass(frozen=True, kw_only=True)
class Series:
    """A published track: the day's start (UTC), and the files with its pixels and with the sun's angles."""

    name: str
    site: Site
    size: tuple[int, int]
    projection: Projection
    day_unix_s: float
    base: str
    pixels: str
    angles: str


SERIES = (
    Series(
        name="fe4_2016-08-30",
        site=Site(latitude=54.495866, longitude=11.237683, altitude=9.0),
        size=(1920, 1920),
        projection="equidistant",
        day_unix_s=1_472_515_200.0,
        base="https://raw.githubusercontent.com/LEX2016WoKaGru/pyclamster/c31bc568cf0605627a4bc4823bf2b71eddbba968/data/fe4/",
        pixels="FE4_straightcalib_sun_img.pk",
        angles="FE4_straightcalib_sun_real.pk",
    ),
)


class _Held:
    """Stands for the authors' classes: their attributes, none of their code."""

    def __init__(self, *_: object) -> None:
        pass

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)


class _Arrays(pickle.Unpickler):
    """Reads arrays alone: every other name of a pickle is the place holder."""

    _NUMPY = frozenset({"_mareconstruct", "MaskedArray", "ndarray", "dtype", "_reconstruct", "scalar"})

    def find_class(self, module_name: str, global_name: str) -> Any:  # noqa: ANN401 - as the base class has it
        if module_name.partition(".")[0] == "numpy" and global_name in self._NUMPY:
            return super().find_class(module_name, global_name)
        return _Held


def fetched(series: Series, base: str) -> Sightings:
    """Return a track from where it was published; the minute of a sighting is that of the authors' angles.

    Raises
    ------
    OSError, pickle.UnpicklingError, KeyError
        Where it is not to be had.
    """
    seen: dict[str, Any] = {}
    sun: dict[str, Any] = {}
    for name, held in ((series.pixels, seen), (series.angles, sun)):
        with urllib.request.urlopen(base + name, timeout=_TIMEOUT_S) as answer:  # noqa: S310 - the series' own address
            held.update(vars(_Arrays(io.BytesIO(answer.read(_LARGEST))).load()))
    x, y, zenith, azimuth = (
        np.ma.filled(part[name], np.nan).ravel()
        for part, name in ((seen, "_x"), (seen, "_y"), (sun, "_elevation"), (sun, "_azimuth"))
    )
    # their y counts from the lower edge
    pixels = np.column_stack([x, series.size[1] - y])
    stated = direction_from_angles(zenith_deg=np.degrees(zenith), azimuth_deg=np.degrees(azimuth))
    minutes = series.day_unix_s + 60.0 * np.arange(1440.0)
    nearest = np.argmax(np.nan_to_num(stated) @ sun_directions(minutes, series.site).T, axis=-1)
    known = np.all(np.isfinite(pixels), axis=-1) & np.all(np.isfinite(stated), axis=-1)
    return Sightings.of(unix_s=minutes[nearest][known], pixels=pixels[known], body=np.full(int(known.sum()), "sun"))


def track_of(series: Series, folder: Path | None, base: str | None) -> Sightings | str:
    """Return a track, or why there is none."""
    if folder is not None:
        path = folder / f"{series.name}.csv"
        try:
            return read_sightings(path.read_text(encoding="utf-8").splitlines(), name=path.name)
        except (OSError, InputError) as error:
            return str(error)
    try:
        return fetched(series, series.base if base is None else base)
    except (OSError, pickle.UnpicklingError, KeyError) as error:
        return f"not to be had from where it is published: {error}"


def cases_of(series: Series, track: Sightings) -> Iterator[tuple[BenchmarkCase, BenchmarkTruth]]:
    """Yield the cases of a track."""
    order = np.argsort(track.unix_s, kind="stable")
    times, pixels = track.unix_s[order], track.pixels[order]
    morning = np.asarray(hour_angle(times, series.site)) < 0.0
    directions = sun_directions(times, series.site)
    scale = local_scale(times, pixels, directions)
    for name, given in (("morning", morning), ("afternoon", ~morning), ("hours", (times // 3600.0) % 2.0 < 1.0)):
        asked = ~given & np.isfinite(scale)
        truth = BenchmarkTruth(
            lens="real",
            condition=name,
            answerable=True,
            pixels=pixels[asked],
            directions=directions[asked],
            track_deg=degrees_to_nearest(directions[asked], directions[given]),
            px_per_deg=scale[asked, None, None] * np.eye(2),
            fallback_deg=np.full(int(asked.sum()), _MOUNT_DEG),
        )
        case = BenchmarkCase(
            name=f"{series.name}_{name}",
            site=series.site,
            image_size=series.size,
            projection=series.projection,
            sightings=Sightings.of(unix_s=times[given], pixels=pixels[given], body=np.full(int(given.sum()), "sun")),
            apparent=directions[given],
            queries=truth.pixels,
        )
        yield case, truth


def local_scale(times: FloatArray, pixels: FloatArray, directions: FloatArray) -> FloatArray:
    """Return (n,): px a degree by the track within 20 minutes; NaN where it has no other sighting there."""
    scale = np.full(times.size, np.nan)
    for k, time in enumerate(times):
        beside = np.flatnonzero(np.abs(times - time) < _BESIDE_S)
        angle = np.degrees(np.arccos(np.clip(float(directions[beside[0]] @ directions[beside[-1]]), -1.0, 1.0)))
        if angle > 0.5:
            scale[k] = np.linalg.norm(pixels[beside[-1]] - pixels[beside[0]]) / angle
    return scale


def main() -> None:
    """Write a round of what is to be had."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tracks", type=Path)
    parser.add_argument("--base", help="where the files of a series are, in place of its authors' address")
    parser.add_argument("--out", type=Path, required=True)
    chosen = parser.parse_args()
    found = []
    for series in SERIES:
        track = track_of(series, chosen.tracks, chosen.base)
        if isinstance(track, str):
            print(f"{series.name}: skipped: {track}")
        else:
            found += list(cases_of(series, track))
    if not found:
        sys.exit("no track is to be had: no round")
    count, digest = write_round(found, folder=chosen.out, part="real", seed=0)
    print(f"{count} cases in {chosen.out / 'cases'}, their truth in {chosen.out / 'truth'}, SHA-256 {digest}")


if __name__ == "__main__":
    main()
