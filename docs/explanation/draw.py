"""Draws the pictures of docs/explanation.md from the data of docs/examples/front_door.

`python docs/explanation/draw.py [FOLDER]`; this folder by default.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse

import sunarc
from sunarc.common.array_types import FloatArray
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.sky.sun import sun_angles, sun_directions

FOLDER = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
DATA = Path(__file__).parents[1] / "examples" / "front_door"
SITE = sunarc.Site(latitude=SGP.latitude, longitude=SGP.longitude, altitude_m=SGP.altitude)
SIZE = (1748, 1748)
SUN, LINE, GREY, BLUE = "#d9480f", "#1c7ed6", "#868e96", "#364fc7"
EXAGGERATED = 200.0
BUMP_DEG = 0.3


def save(figure: Figure, name: str) -> None:
    """Write a figure as PNG."""
    figure.savefig(FOLDER / f"{name}.png", dpi=80, metadata={"Software": None})
    plt.close(figure)


def as_picture(axes: Axes, title: str) -> None:
    """Give axes the picture's pixels, y down."""
    axes.set(xlim=(0, SIZE[0]), ylim=(SIZE[1], 0), aspect="equal", xticks=[], yticks=[], title=title)
    axes.add_patch(Circle((872, 883), 860, fill=False, color=GREY, lw=0.8))


def draw_sighting() -> None:
    """Draw a picture of the day, and the sun that is found in it."""
    path = DATA / "pictures" / "20130513T154400Z.jpg"
    image = np.asarray(cv2.imread(str(path)))[..., ::-1]
    found = sunarc.find_sun(path)
    if found.x_px is None or found.y_px is None:
        raise ValueError(found.reason)
    figure, (whole, near) = plt.subplots(1, 2, figsize=(8, 4), layout="constrained")
    whole.imshow(image)
    whole.add_patch(Circle((found.x_px, found.y_px), 16, fill=False, color=SUN, lw=1.5))
    whole.set_title("a picture at 15:44 UTC")
    near.imshow(image, interpolation="nearest")
    near.plot(found.x_px, found.y_px, "+", color=SUN, ms=30, mew=1.5)
    near.set(xlim=(found.x_px - 45, found.x_px + 45), ylim=(found.y_px + 45, found.y_px - 45))
    near.set_title(f"sun at x {found.x_px:.2f}, y {found.y_px:.2f} px")
    for axes in (whole, near):
        axes.set(xticks=[], yticks=[])
    save(figure, "sighting")


def draw_fit(sightings: sunarc.Sightings, calibration: sunarc.Calibration) -> None:
    """Draw a day's sightings, where the fitted camera expects them, and the difference."""
    angles = sunarc.sun_position(sightings.time, SITE)
    expected = calibration.project(zenith_deg=angles.zenith_deg, azimuth_deg=angles.azimuth_deg)
    dx, dy = sightings.x_px - expected.x_px, sightings.y_px - expected.y_px
    figure, axes = plt.subplots(figsize=(5, 5), layout="constrained")
    as_picture(axes, f"differences {EXAGGERATED:.0f} times as long")
    axes.plot(expected.x_px, expected.y_px, color=LINE, lw=1, label="expected by the fitted camera")
    few = slice(None, None, 6)
    axes.quiver(
        expected.x_px[few], expected.y_px[few], dx[few], dy[few],
        angles="xy", scale_units="xy", scale=1 / EXAGGERATED, color=SUN, width=0.004, label="to the sighting",
    )  # fmt: skip
    figure.legend(loc="outside lower center", frameon=False)
    save(figure, "fit")


def draw_sigma(calibration: sunarc.Calibration) -> None:
    """Draw the map of 1-sigma, and where possible cameras place one direction."""
    figure, (whole, near) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    calibration.plot_uncertainty(ax=whole)
    at = calibration.project(zenith_deg=60.0, azimuth_deg=0.0)
    drawn = calibration.draw(400, seed=1).project(zenith_deg=60.0, azimuth_deg=0.0)
    near.plot(drawn.x_px, drawn.y_px, ".", color=LINE, ms=2, label="400 cameras that the sightings allow")
    values, axes = np.linalg.eigh(at.covariance_px2)
    width, height = 2.0 * np.sqrt(5.991 * values)
    angle = np.degrees(np.arctan2(axes[1, 0], axes[0, 0]))
    ellipse = Ellipse(
        (at.x_px, at.y_px), width, height, angle=angle, fill=False, color=SUN, label="stated ellipse of 95 %"
    )
    near.add_patch(ellipse)
    near.invert_yaxis()
    near.set(aspect="equal", xlabel="x, px", ylabel="y, px", title="the direction 60° from zenith, due north")
    near.legend(loc="best", fontsize=7)
    save(figure, "sigma")


def seen(camera: Camera, unix_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return where a camera sees the sun, (n, 2) px, with a noise of 0.15 px."""
    return project(camera, sun_directions(unix_s, SGP)) + rng.normal(0.0, 0.15, (unix_s.size, 2))


def draw_bump(calibration: sunarc.Calibration) -> None:
    """Draw the differences of a day at whose noon the camera is turned."""
    rng = np.random.default_rng(2)
    before = true_camera(0)
    turn = rotation_matrix(np.radians([BUMP_DEG, 0.0, 0.0]))
    turned = rotation_vector(turn @ rotation_matrix(before.rotation_cam_enu))
    after = replace(before, rotation_cam_enu=turned)
    start = datetime(2013, 5, 15, 11, 44, tzinfo=UTC).timestamp()
    unix_s = start + np.arange(0.0, 13.4 * 3600.0, 240.0)
    unix_s = unix_s[sun_angles(unix_s, SGP).apparent_zenith < 85.0]
    noon = datetime(2013, 5, 15, 18, 30, tzinfo=UTC).timestamp()
    pixels = np.where((unix_s < noon)[:, None], seen(before, unix_s, rng), seen(after, unix_s, rng))
    times = np.array(unix_s * 1e6, dtype="datetime64[us]")
    angles = sunarc.sun_position(times, SITE)
    expected = calibration.project(zenith_deg=angles.zenith_deg, azimuth_deg=angles.azimuth_deg)
    figure, axes = plt.subplots(figsize=(8, 3), layout="constrained")
    hours = (unix_s - start) / 3600.0 + 11.0 + 44.0 / 60.0
    axes.plot(hours, pixels[:, 0] - expected.x_px, ".", color=LINE, label="x")
    axes.plot(hours, pixels[:, 1] - expected.y_px, ".", color=SUN, label="y")
    axes.axvline(18.5, color=GREY, lw=1)
    axes.annotate(f"turned by {BUMP_DEG}°", (18.5, 0.0), (18.7, 1.0))
    axes.set(xlabel="hour, UTC", ylabel="seen minus expected, px")
    axes.legend(frameon=False, loc="upper left")
    save(figure, "bump")


def draw_day_and_night(sightings: sunarc.Sightings) -> None:
    """Draw where a day's suns and one image's stars lie in the picture."""
    stars = sunarc.find_stars(DATA / "night.png", time=np.datetime64("2013-05-14T05:00:00"), site=SITE)
    if isinstance(stars, list):
        raise TypeError(len(stars))
    scale = SIZE[0] / 360.0
    figure, axes = plt.subplots(figsize=(5, 5), layout="constrained")
    as_picture(axes, "where sun and stars were seen")
    axes.plot(sightings.x_px, sightings.y_px, ".", color=SUN, ms=3, label="the sun, 13 hours of one day")
    axes.plot(
        stars.x_px * scale, stars.y_px * scale, "*", color=BLUE, ms=5, label=f"{len(stars.x_px)} stars of one image"
    )
    figure.legend(loc="outside lower center", frameon=False)
    save(figure, "day_and_night")


def draw_archive() -> None:
    """Draw the epochs of an archive: a bump, another lens, a clock that was an hour off."""
    figure, axes = plt.subplots(figsize=(8, 2.2), layout="constrained")
    epochs = [(0, 41, "001"), (41, 118, "002 turned by 1.2°"), (118, 200, "003 another lens")]
    for k, (begin, end, name) in enumerate(epochs):
        axes.barh(1, end - begin, left=begin, height=0.6, color=[LINE, "#74c0fc", BLUE][k], edgecolor="white")
        axes.text((begin + end) / 2, 1, name, ha="center", va="center", color="white", fontsize=9)
    clock = [(0, 150, "clock right"), (150, 168, "+1 h"), (168, 200, "right")]
    for begin, end, name in clock:
        axes.barh(0, end - begin, left=begin, height=0.6, color=SUN if "+" in name else GREY, edgecolor="white")
        axes.text((begin + end) / 2, 0, name, ha="center", va="center", color="white", fontsize=9)
    axes.set(yticks=[0, 1], yticklabels=["clock", "calibration"], xlabel="day of the archive", xlim=(0, 200))
    save(figure, "archive")


def main() -> None:
    """Draw all pictures."""
    sightings = sunarc.read_sightings(DATA / "sun.csv")
    calibration = sunarc.calibrate(sightings, SITE, image_size=SIZE)
    draw_sighting()
    draw_fit(sightings, calibration)
    draw_sigma(calibration)
    draw_bump(calibration)
    draw_day_and_night(sightings)
    draw_archive()


if __name__ == "__main__":
    main()
