"""The command `sunarc stars`: parse, call, print."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.selection import MOST_STARS
from sunarc.cli.options import (
    Altitude,
    AsJson,
    FollowExif,
    LatitudeIfGiven,
    LongitudeIfGiven,
    TimePatternOption,
    parse_angles,
    parse_choice,
    print_json,
    print_sentence,
    print_table,
)
from sunarc.cli.owner import act_as_folder_owner
from sunarc.common.errors import InputError, disk_errors
from sunarc.common.messages import counted
from sunarc.detection.values import BAYERS
from sunarc.formats.csv_files import read_sightings
from sunarc.imager.runtime.clock import SystemClock
from sunarc.public.calibrate_files import parse_image_circle
from sunarc.public.calibration_files import read_calibration
from sunarc.public.star_files import StarImage, StarOptions, find_stars, find_stars_blind, write_star_sightings
from sunarc.sky.site import Site
from sunarc.sources.file_kinds import without_derived
from sunarc.sources.files import read_lines
from sunarc.sources.image_times import TimeRules, parse_utc_offset
from sunarc.stars.blind_start import BlindOptions

BLIND = "Without a calibration"


def stars(
    images: Annotated[list[Path], typer.Argument(help="Images of the night: PNG, JPEG, TIFF, FITS (extra fits).")],
    *,
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="A calibration document (JSON), unless --blind.")
    ] = None,
    blind: Annotated[
        bool, typer.Option("--blind", help="Without a calibration: find the camera by images of one night, or by one.")
    ] = False,
    write_calibration: Annotated[
        Path | None,
        typer.Option(
            callback=act_as_folder_owner, help="The calibration that --blind found (JSON).", rich_help_panel=BLIND
        ),
    ] = None,
    latitude: LatitudeIfGiven = None,
    longitude: LongitudeIfGiven = None,
    altitude: Altitude = 0.0,
    image_circle: Annotated[
        str | None, typer.Option(help="X,Y,RADIUS in px, or a daytime image that shows it.", rich_help_panel=BLIND)
    ] = None,
    level_within: Annotated[
        float | None, typer.Option(help="How far the camera is tilted at most, degrees.", rich_help_panel=BLIND)
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", callback=act_as_folder_owner, help="CSV of the stars' sightings.")
    ] = None,
    beside: Annotated[
        Path | None, typer.Option(help="Sightings of the sun (CSV), written before the stars': all in one file.")
    ] = None,
    time_pattern: TimePatternOption = None,
    utc_offset: Annotated[
        str | None,
        typer.Option(help="Times without a zone, ahead of UTC: 0 unless given; hours, or as Europe/Berlin."),
    ] = None,
    to_middle: Annotated[float, typer.Option(help="Seconds from the stated time to mid-exposure.")] = 0.0,
    clock_error: Annotated[
        float,
        typer.Option(help="Bound of the clock's error, s; it turns the pose.", rich_help_panel=BLIND),
    ] = 10.0,
    within: Annotated[float, typer.Option(help="1-sigma of the prediction beside the calibration's own, px.")] = 0.0,
    full_scale: Annotated[int | None, typer.Option(help="Largest count; judged from the file unless given.")] = None,
    follow_exif: FollowExif = False,
    bayer: Annotated[str | None, typer.Option(help="Colours of a raw mosaic: RGGB, BGGR, GRBG or GBRG.")] = None,
    gain: Annotated[float | None, typer.Option(help="Electrons per count of a linear camera.")] = None,
    most: Annotated[int, typer.Option(help="Stars that are written, the surest of each part of the sky.")] = MOST_STARS,
    as_json: AsJson = False,
) -> None:
    """Detect and identify stars in images of the night; exit 1 when none matches, or one is of another site.

    With --beside the output holds the sun's sightings as well, for the next sunarc calibrate. Give two images or more,
    ten minutes apart, so that hot pixels and lamps are known.

    With --blind no calibration is needed, for cameras within 20 degrees of the zenith (or --level-within, by which a
    wrong latitude shows): what turns in images of one night (an hour or more apart) gives lens and pole, and the bright
    stars the rest; of one image their pattern all.
    North is then right as the images' clock is: within --clock-error, which the stated uncertainty holds.

    Example: sunarc stars night/*.png --calibration calibration.json --beside sun.csv -o sightings.csv

    Example: sunarc stars night/*.jpg --blind --latitude 36.6 --longitude -97.5 --write-calibration camera.json
    """
    images, electrons = without_derived(images), 1.0 if gain is None else gain
    for name, value, least in (
        ("--within", within, 0.0),
        ("--most", float(most), 1.0),
        ("--gain", electrons, 1e-9),
        ("--clock-error", clock_error, 0.0),
    ):
        if not least <= value < 1e6:
            raise InputError(field=name, problem=f"{value:g} is out of range", remedy="give a positive number")
    options = StarOptions(
        rules=TimeRules(
            time_pattern,
            parse_utc_offset(utc_offset or "0", field="--utc-offset"),
            documents=True,
            is_offset_assumed=utc_offset is None,
        ),
        to_middle_s=to_middle,
        within_px=within,
        full_scale=full_scale,
        bayer=None if bayer is None else parse_choice("--bayer", bayer, BAYERS),
        gain_e_per_count=gain,
        clock_error_s=clock_error,
        follow_exif=follow_exif,
    )
    known_camera = None if blind or calibration is None else read_calibration(calibration)
    place = (
        known_camera.site
        if known_camera is not None
        else _choose_site(calibration, *parse_angles(latitude, longitude), altitude, blind=blind)
    )
    sun = None if beside is None else read_sightings(read_lines(beside), name=beside.name, site=place)
    if known_camera is None:
        circle = None if image_circle is None else parse_image_circle(image_circle)
        known = BlindOptions(level_within_deg=level_within, circle=circle)
        found = _find_blind(images, place, options, known, write_calibration, as_json=as_json)
    else:
        found = find_stars(images, known_camera, options)
        if as_json:
            print_json([image.as_json() for image in found])
        else:
            _print_images(found)
    if not any(image.matches is not None and image.matches.accepted for image in found):
        raise typer.Exit(2 if all(image.time is None for image in found) else 1)
    if output is not None:
        count = _write_sightings(output, found, sun, most)
        if not as_json:
            print(f"{counted(count, 'sighting')} of stars written to {output}")
    if any(finding.code == "file_other_site" for image in found for finding in image.findings):
        raise typer.Exit(1)


def _choose_site(
    calibration: Path | None, latitude: float | None, longitude: float | None, altitude: float, *, blind: bool
) -> Site:
    """Return the site of a blind start; InputError where neither it nor a substitute is given."""
    if not blind:
        raise InputError(field="--calibration", problem="is missing", remedy="give one, or --blind and the site")
    if calibration is not None:
        raise InputError(field="--calibration", problem="beside --blind", remedy="give one of them")
    if latitude is None or longitude is None:
        raise InputError(field="--blind", problem="has no site", remedy="give --latitude and --longitude")
    return Site(latitude=latitude, longitude=longitude, altitude=altitude)


def _find_blind(
    images: list[Path], site: Site, options: StarOptions, known: BlindOptions, target: Path | None, *, as_json: bool
) -> list[StarImage]:
    """Return the images with their stars named by the camera that they gave, and write its calibration."""
    result = find_stars_blind(images, site, options, known=known)
    if as_json:
        print_json(result.as_json())
    else:
        _print_images(result.images)
        print(result.as_json()["reason"])
    if result.accepted and target is not None:
        text = json.dumps(result.document(camera=target.stem, now=SystemClock().now()), indent=2)
        with disk_errors(target):
            target.write_text(text + "\n", encoding="utf-8")
    return result.images


def _print_images(found: list[StarImage]) -> None:
    rows = [image.as_json() for image in found]
    columns = ("file", "time_utc", "n_detected", "n_stars", "scatter_px")
    header = ("file", "time", "detected", "stars", "scatter\npx")
    print_table(header, [[row[column] for column in columns] for row in rows])
    for row in rows:
        if row["reason"]:
            print_sentence(f"{row['file']}: {row['reason']}")


def _write_sightings(output: Path, found: list[StarImage], sun: Sightings | None, most: int) -> int:
    with disk_errors(output), output.open("w", encoding="utf-8", newline="") as target:
        return write_star_sightings(target, found, beside=sun, most=most)
