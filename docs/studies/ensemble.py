"""An ensemble of a calibration's errors: its covariance beside the stated one, and its cost beside one back-projection.

    OMP_NUM_THREADS=1 python docs/studies/ensemble.py CALIBRATION.json [--draws 2000] [--pixels 1000000]

The ratio of the draws' variance to the stated one over the sky inside the image (mean, smallest and largest place), and
processor time: of drawing, of back-projecting the pixels once with their sigma, and of one draw.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.answers.direction_table import lookup
from sunarc.calibration.answers.error_model import draw_ensemble
from sunarc.optics.camera import camera_sees
from sunarc.public.calibration_files import read_calibration


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("calibration", type=Path)
    parser.add_argument("--draws", type=int, default=2000)
    parser.add_argument("--pixels", type=int, default=1_000_000)
    chosen = parser.parse_args()
    calibration = read_calibration(chosen.calibration)
    begun = time.process_time()
    ensemble = draw_ensemble(calibration, draws=chosen.draws, seed=1, calibration_id="study")
    drawing = (time.process_time() - begun) / chosen.draws
    sky = hemisphere(600)
    pixels, stated = project_with_covariance(calibration, sky)
    inside = camera_sees(calibration.camera, pixels)
    errors = np.stack([ensemble.project(draw, sky[inside]) - pixels[inside] for draw in ensemble])
    ratio = np.mean(np.sum(errors**2, axis=-1), axis=0) / np.trace(stated[inside], axis1=1, axis2=2)
    places = f"at {int(inside.sum())} places: mean {ratio.mean():.4f}, {ratio.min():.3f} to {ratio.max():.3f}"
    print(f"variance of {chosen.draws} draws over the stated one {places}; {1e3 * drawing:.2f} ms to make a draw")
    size = [calibration.camera.width, calibration.camera.height]
    many = np.random.default_rng(0).uniform(0.0, size, (chosen.pixels, 2))
    ready = lookup(calibration)
    once, one_draw = [], []
    for _ in range(5):
        begun = time.process_time()
        ready.back_project(many)
        once.append(time.process_time() - begun)
        begun = time.process_time()
        ensemble.back_project(0, many)
        one_draw.append(time.process_time() - begun)
    cost = f"once {min(once):.3f} s with sigma, a draw {min(one_draw):.3f} s, ratio {min(one_draw) / min(once):.2f}"
    print(f"{chosen.pixels} pixels: {cost}")


if __name__ == "__main__":
    main()
