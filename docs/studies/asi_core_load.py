"""Whether asi_core's own loader keeps an exported set, and where it then sees each pixel.

    git clone https://github.com/DLR-SF/Sky-Imaging
    python3 -m venv asi && asi/bin/pip install numpy scipy pyyaml jsonschema pillow opencv-python-headless pandas pytz \
        fastcore
    sunarc export --calibration calibration.json --format asi-core -o cameras/
    asi/bin/python docs/studies/asi_core_load.py Sky-Imaging cameras/

Exits 1 where its folder loader drops a camera file, a mask or a matrix does not load, or a view direction above the
horizon is off by more than a degree from that of the matrices. (The package `asi-core` of the Python package index is
another, empty one.)
"""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def main() -> int:
    """Print what the loader says of each camera file and how far its directions are from those of the matrices."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", type=Path)
    parser.add_argument("folder", type=Path)
    chosen = parser.parse_args()
    sys.path.insert(0, str(chosen.checkout))
    from asi_core.camera import sky_imager  # noqa: PLC0415 - of the loader's environment

    logging.basicConfig(level=logging.WARNING)
    kept = sky_imager.load_camera_data(camera_data_dir=chosen.folder)
    files = sorted(path.name for path in chosen.folder.glob("*.yaml"))
    print(f"kept: {len(kept)} of {len(files)} camera files")
    good = [_one(sky_imager, chosen.folder, name) for name in files if name in kept]
    return 0 if all(good) and len(kept) == len(files) else 1


def _one(sky_imager: Any, folder: Path, name: str) -> bool:  # noqa: ANN401 - a module of the loader's environment
    imager = sky_imager.AllSkyImager.from_file(folder / name)
    camera = sky_imager.load_camera_data(camera_data_file=folder / name)
    elevation, azimuth = sky_imager.load_celestial_coordinate_masks(folder / camera["celestial_coordinate_masks"])
    stem = name.removesuffix(".yaml")
    same = np.array_equal(np.load(folder / f"elevation_matrix_{stem}.npy"), elevation, equal_nan=True)
    exact, theirs = _directions(azimuth, elevation), _directions(imager.azimuth_mask, imager.elevation_mask)
    apart = np.degrees(2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(theirs - exact, axis=-1), 0.0, 1.0)))
    zenith = 90.0 - np.degrees(elevation)
    for low, high in ((0, 30), (30, 60), (60, 80), (80, 90), (0, 90)):
        within = apart[np.isfinite(apart) & (zenith >= low) & (zenith < high)]
        print(
            f"{name}: zenith angle {low}-{high}: {np.sqrt(np.mean(within**2)):.3f} deg RMS, {within.max():.3f} at most"
        )
    mask = getattr(imager, "camera_mask", None)
    print(f"{name}: mask {None if mask is None else mask.shape}, matrices alike: {same}")
    return bool(same and mask is not None and mask.shape == elevation.shape and np.nanmax(apart) < 1.0)


def _directions(azimuth: NDArray[Any], elevation: NDArray[Any]) -> NDArray[Any]:
    """Return unit vectors; asi_core counts azimuth from east, counter-clockwise."""
    across = np.cos(elevation)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)], axis=-1)


if __name__ == "__main__":
    sys.exit(main())
