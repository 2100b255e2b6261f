"""Two versions of the fit on the same lenses with the same sightings: errors, coverage and verdicts side by side.

    python docs/studies/coverage.py --lenses 200 --first 8000 --worlds FOLDER
    PYTHONPATH=SERVICE_OF_A_VERSION OMP_NUM_THREADS=1 python docs/studies/coverage_pairs.py FOLDER --to VERSION.jsonl
    python docs/studies/coverage_pairs.py --compare BEFORE.jsonl AFTER.jsonl

What is fitted is read, so that versions are given the same numbers to the last bit. Printed for every case of which
both are known, before and after: the median and the 90th percentile over lenses of the error over the sky, px, and 95 %
intervals of their ratio by bootstrap over lenses; the shares within the stated 50, 68, 95 and 99 %; and how many are
accepted. A version before 0.4 states one Gaussian.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from coverage_statistics import TrueSky, judged
from numpy.typing import NDArray

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions, LensTolerances
from sunarc.calibration.model.sightings import Sightings
from sunarc.optics.camera import Camera
from sunarc.sky.site import Site

FloatArray = NDArray[np.float64]
Answers = dict[str, list[float]]
"""What `judged` says of each lens, by its number."""
_DRAWS = 2000


def camera_of(known: dict[str, object]) -> Camera:
    """Return the camera whose fields, in JSON, are these."""
    plain = {name: tuple(value) if isinstance(value, list) else value for name, value in known.items()}
    return Camera(**(plain | {"rotation_cam_enu": np.array(known["rotation_cam_enu"])}))  # type: ignore[arg-type]


def fitted(path: Path, tolerances: LensTolerances) -> Answers:
    """Return what `judged` says of the fit of each lens of a file."""
    answers: Answers = {}
    with np.load(path) as worlds:
        for seed in [name.removesuffix(".known") for name in worlds.files if name.endswith(".known")]:
            known = json.loads(str(worlds[f"{seed}.known"]))
            camera = camera_of(known["camera"])
            points = Sightings.of(unix_s=worlds[f"{seed}.unix_s"], pixels=worlds[f"{seed}.sighted"], clock_error_s=0.0)
            fit = calibrate(
                points,
                site=Site(**known["site"]),
                image_size=(camera.width, camera.height),
                options=CalibrationOptions(projection=camera.projection, tolerances=tolerances, level_within_deg=60.0),
                start=camera,
            )
            true = TrueSky(*(worlds[f"{seed}.{name}"] for name in TrueSky._fields))
            answers[seed] = [float(value) for value in judged(fit, true)]
    return answers


def read(path: Path) -> dict[str, Answers]:
    """Return the answers of a version by case and lens."""
    found: dict[str, Answers] = {}
    for line in path.read_text().splitlines():
        for case, answers in json.loads(line).items():
            found.setdefault(case, {}).update(answers)
    return found


def ratio(before: FloatArray, after: FloatArray, quantile: float) -> str:
    """Return a quantile of both, and the interval of the ratio."""
    picks = np.random.default_rng(1).integers(0, before.size, (_DRAWS, before.size))
    old, new = (np.quantile(error, quantile) for error in (before, after))
    ratios = np.quantile(after[picks], quantile, axis=1) / np.quantile(before[picks], quantile, axis=1)
    low, high = np.quantile(ratios, [0.025, 0.975])
    return f"{old:.3f}/{new:.3f} ({low:.2f}–{high:.2f})"


def pooled(pairs: list[tuple[Answers, Answers]], quantile: float) -> str:
    """Return the geometric mean over cases of the ratio of a quantile; a lens of all cases is drawn again as one."""
    seeds, rng = sorted({seed for old, _ in pairs for seed in old}), np.random.default_rng(1)

    def mean(drawn: list[str]) -> float:
        ratios = []
        for old, new in pairs:
            kept = [seed for seed in drawn if seed in old and seed in new]
            if not kept:  # a case of few lenses
                continue
            errors = np.array([[old[seed][0], new[seed][0]] for seed in kept])
            ratios.append(float(np.divide(*np.quantile(errors, quantile, axis=0)[::-1])))
        return float(np.exp(np.mean(np.log(ratios))))

    low, high = np.quantile([mean(rng.choice(seeds, len(seeds)).tolist()) for _ in range(200)], [0.025, 0.975])
    return f"{mean(seeds):.3f} ({low:.3f}–{high:.3f})"


def compare(before: Path, after: Path) -> None:
    """Print the table, and the ratios of all cases but those of the pole."""
    olds, news = read(before), read(after)
    print("| case | lenses | median | P90 | 50, 68, 95, 99 % | accepted |\n|---|---|---|---|---|---|")
    pairs = []
    for case, answers in news.items():
        both = [seed for seed in answers if seed in olds.get(case, {})]
        if not both:
            continue
        old, new = (np.array([known[case][seed] for seed in both]) for known in (olds, news))
        shares = ("/".join(f"{share:.3f}" for share in rows[:, 2:6].mean(axis=0)) for rows in (old, new))
        quantiles = " | ".join(ratio(old[:, 0], new[:, 0], quantile) for quantile in (0.5, 0.9))
        accepted = f"{old[:, 1].sum():.0f}/{new[:, 1].sum():.0f}"
        print(f"| {case} | {len(both)} | {quantiles} | {', '.join(shares)} | {accepted} |")
        if not case.startswith("the pole"):
            pairs.append((olds[case], answers))
    if pairs:
        print(f"{len(pairs)} cases, ratio of the median {pooled(pairs, 0.5)}, of the P90 {pooled(pairs, 0.9)}")


def main() -> None:
    """Fit, or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("worlds", type=Path, nargs="?", help="folder of coverage.py --worlds")
    parser.add_argument("--to", type=Path, help="file to add the answers to")
    parser.add_argument("--tolerance", action="append", default=[], metavar="NAME=VALUE", help="another prior's scale")
    parser.add_argument("--compare", type=Path, nargs=2, metavar=("BEFORE", "AFTER"))
    chosen = parser.parse_args()
    if chosen.compare is not None:
        compare(*chosen.compare)
        return
    scales = dict(one.split("=") for one in chosen.tolerance)
    tolerances = LensTolerances(**{name: float(value) for name, value in scales.items()})
    for path in sorted(chosen.worlds.glob("*.npz")):
        answers = fitted(path, tolerances)
        with chosen.to.open("a") as lines:
            lines.write(json.dumps({path.stem: answers}) + "\n")


if __name__ == "__main__":
    main()
