"""Whether asi_core's own loader takes an exported camera file, and where it then sees each pixel.

    git clone https://github.com/DLR-SF/Sky-Imaging
    python3 -m venv asi && asi/bin/pip install numpy scipy pyyaml jsonschema pillow opencv-python-headless pandas pytz \
        fastcore
    sunarc export --calibration calibration.json --format asi-core -o camera.yaml
    sunarc export --calibration calibration.json --format map-npz -o map.npz
    asi/bin/python docs/studies/asi_core_load.py Sky-Imaging camera.yaml map.npz

Exits 1 where its schema refuses the file, its mask does not load, or a view direction above the horizon is off by more
than a degree. (The package `asi-core` of the Python package index is another, empty one.)
"""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

import numpy as np


def main() -> int:
    """Print what the loader says and how far its directions are from those of the map."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", type=Path)
    parser.add_argument("camera", type=Path)
    parser.add_argument("map", type=Path)
    chosen = parser.parse_args()
    sys.path.insert(0, str(chosen.checkout))
    import jsonschema  # noqa: PLC0415 - of the loader's environment, as the next two
    import yaml  # noqa: PLC0415
    from asi_core.camera.sky_imager import CAMERA_DATA_SCHEMA, AllSkyImager  # noqa: PLC0415

    logging.basicConfig(level=logging.WARNING)
    jsonschema.validate(yaml.safe_load(chosen.camera.read_text()), yaml.safe_load(CAMERA_DATA_SCHEMA.read_text()))
    imager = AllSkyImager.from_file(chosen.camera)
    ours = np.load(chosen.map)
    elevation, azimuth = imager.elevation_mask, 0.5 * np.pi - imager.azimuth_mask
    across = np.cos(elevation)
    theirs = np.stack([across * np.sin(azimuth), across * np.cos(azimuth), np.sin(elevation)], axis=-1)
    apart = np.degrees(2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(theirs - ours["direction"], axis=-1), 0.0, 1.0)))
    above = np.isfinite(apart) & (ours["zenith"] < 90.0)
    rms, most = float(np.sqrt(np.mean(apart[above] ** 2))), float(np.max(apart[above]))
    mask = getattr(imager, "camera_mask", None)
    shape = None if mask is None else mask.shape
    print(f"schema: valid; mask: {shape}; directions: {rms:.3f} deg RMS, {most:.3f} at most")
    return 0 if mask is not None and mask.shape == elevation.shape and most < 1.0 else 1


if __name__ == "__main__":
    sys.exit(main())
