"""The newest image, its sun mask, a map of the sky and a cloud's place with errors; then waits for a calibration.

python afternoon.py http://imager:8080 FOLDER
"""

import sys
from datetime import datetime
from pathlib import Path

from sunarc.client import Imager

imager, folder = Imager(sys.argv[1]), Path(sys.argv[2])
newest = next(imager.images())
time = newest["time"]
at = datetime.fromisoformat(time)
width, height = imager.status()["image_size"]
pixel = [0.52 * width, 0.4 * height]
(folder / f"newest.{newest['format']}").write_bytes(imager.image(time))
(folder / "sun_mask.png").write_bytes(imager.sun_mask(at=at))
(folder / "sky.png").write_bytes(imager.rectified(time))
seen = imager.back_project(pixel, at=at)
print(f"direction: zenith {seen.zenith_deg:.3f}, azimuth {seen.azimuth_deg:.3f}, 1-sigma {seen.sigma_deg:.4f} degrees")
cloud, shadow = imager.geolocate(pixel, height_m=1500.0, height_sigma_m=100.0, at=at)
for name, place in (("cloud", cloud), ("shadow", shadow)):
    print(f"{name}: {place.latitude:.5f}, {place.longitude:.5f}, 1-sigma {place.sigma_m:.1f} m")
event = next(event for event in imager.events() if event.kind == "calibration")
print("calibration:", event.data["calibration"])
