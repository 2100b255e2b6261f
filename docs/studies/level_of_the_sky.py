"""By how much a simulated sky becomes brighter or darker all over within 30 s and 120 s, through a day of each weather.

    python docs/studies/level_of_the_sky.py [--moments 25]

Capture holds a factor beyond 2 against a cycle (decision 21); this is how near a sky comes to it.
"""

from __future__ import annotations

import argparse
from datetime import UTC, datetime

from sunarc.imaging.brightness import Exposed, Level, factor_all_over, measure_level
from sunarc.lab.simulation.options import WEATHERS, SceneOptions
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera

_DAWN = datetime(2013, 5, 13, 11, 0, tzinfo=UTC).timestamp()
_DAY_S = 14.8 * 3600.0
_EXPOSURES_US = (3e3, 12e3, 48e3)
_LATER_S = (30.0, 120.0)


def level(scene: Scene, unix_s: float) -> Level:
    """Return the level of a cycle at a moment."""
    return measure_level(
        [
            Exposed(image=scene.render(round(unix_s * 1e6), exposure_us=us), exposure_us=us, full_scale=4095)
            for us in _EXPOSURES_US
        ]
    )


def main() -> None:
    """Print the range for each weather."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--moments", type=int, default=25, help="of the day, dawn and dusk included")
    moments = parser.parse_args().moments
    for weather in WEATHERS:
        scene = Scene(true_camera(), SGP, options=SceneOptions(weather=(weather,)))
        factors: dict[float, list[float]] = {later_s: [] for later_s in _LATER_S}
        sun = 0.0
        for number in range(moments):
            at_s = _DAWN + _DAY_S * number / max(moments - 1, 1)
            before = level(scene, at_s)
            for later_s in _LATER_S:
                factor = factor_all_over(before, level(scene, at_s + later_s))
                factors[later_s] += [] if factor is None else [factor]
                sun = max(sun, abs(scene.sun_transmittance(at_s) - scene.sun_transmittance(at_s + later_s)))
        for later_s, seen in factors.items():
            extent = f"{min(seen):.2f} to {max(seen):.2f}" if seen else "no level"
            print(f"{weather:9} {later_s:5.0f} s: {extent} ({len(seen)} times)")
        print(f"{weather:9} the sun itself changed by up to {sun:.2f} of its light")


if __name__ == "__main__":
    main()
