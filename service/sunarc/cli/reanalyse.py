"""The command `sunarc reanalyse`: parse, ask, call, print."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Annotated, get_args

import typer

from sunarc.archives.cluster import WORKER_BYTES, Cluster, Workers
from sunarc.archives.pool import usable_processors
from sunarc.archives.results import Summary
from sunarc.archives.run import ReanalysisOptions, reanalyse
from sunarc.calibration.model.options import CalibrationOptions, Mirrored
from sunarc.cli.options import (
    SITE,
    TIME_PATTERN_HELP,
    AsJson,
    ClockError,
    DetectionMethod,
    FollowExif,
    LatitudeIfGiven,
    LevelWithin,
    LongitudeIfGiven,
    MirroredOption,
    ProjectionOption,
    parse_angles,
    parse_choice,
    parse_image_size,
    print_json,
    print_sentence,
    print_table,
    progress_bars,
    stated_once,
)
from sunarc.cli.owner import act_as_folder_owner
from sunarc.common.errors import InputError
from sunarc.common.foreign_files import name_text
from sunarc.common.messages import counted, significant
from sunarc.imager.runtime.clock import SystemClock
from sunarc.optics.projections import PROJECTIONS
from sunarc.public.calibration_files import read_calibration
from sunarc.sky.site import Site
from sunarc.sources.detect_files import METHODS
from sunarc.sources.image_times import TimeRules, parse_utc_offset
from sunarc.sources.index import CameraPlan, Indexed, Selector, index_archive, new_camera_name, read_cameras
from sunarc.sources.source_dates import by_date
from sunarc.sources.sources import upright_addresses
from sunarc.sources.time_patterns import checked_pattern

_LISTED = 10
"""Files that are named with the reason why they are left out; failures.csv has all."""


def reanalyse_archive(
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            help="Folders, zip or tar archives, or addresses of fsspec; each is a camera, those of days are one.",
            show_default=False,
        ),
    ] = None,
    *,
    target: Annotated[
        Path,
        typer.Option(
            "--output", "-o", callback=act_as_folder_owner, help="Folder of the results; a run goes on where it was."
        ),
    ],
    latitude: LatitudeIfGiven = None,
    longitude: LongitudeIfGiven = None,
    altitude: Annotated[float, typer.Option(help="Metres above sea level.", rich_help_panel=SITE)] = 0.0,
    image_size: Annotated[str | None, typer.Option(help="W,H in px; what most images have unless given.")] = None,
    cameras: Annotated[
        Path | None, typer.Option(help="TOML: whose each file is, where each camera stands, how its times are read.")
    ] = None,
    time_pattern: Annotated[
        list[str] | None,
        typer.Option(help=f"{TIME_PATTERN_HELP} CAMERA=PATTERN for one camera. Repeat it."),
    ] = None,
    utc_offset: Annotated[
        str | None,
        typer.Option(help="How far times without a zone are ahead of UTC: hours, 0, or a zone as Europe/Berlin."),
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="A calibration document (JSON) that the search for epochs begins with.")
    ] = None,
    follow_exif: FollowExif = False,
    method: DetectionMethod = "auto",
    projection: ProjectionOption = None,
    mirrored: MirroredOption = None,
    level_within: LevelWithin = None,
    clock_error: ClockError = None,
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler, tcp://….")] = None,
    workers: Annotated[
        int | None, typer.Option(help="Processes on this machine; one for each processor unless given.", min=1)
    ] = None,
    store: Annotated[
        str | None, typer.Option(help="Address of the ledger; ledger.sqlite in the folder unless given.")
    ] = None,
    exports: Annotated[bool, typer.Option(help="Write the calibrations in all formats, too.")] = True,
    provisional: Annotated[bool, typer.Option("--provisional", help="As sunarc calibrate --provisional.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask whether the times are right.")] = False,
    as_json: AsJson = False,
) -> None:
    """Find the sun in an archive of images, the pose epochs of its cameras, and a calibration for each.

    Exits 1 where a camera has no image that can be used or no epoch, where the calibration of an epoch is refused, and
    where a FITS file has no time.

    Example: sunarc reanalyse images/ --latitude 36.6 --longitude -97.5 --altitude 318 --utc-offset 0 -o result
    """
    common = CameraPlan(
        name="camera",
        site=_choose_site(*parse_angles(latitude, longitude), altitude, cameras, calibration),
        selector=Selector(tuple(one if "://" in one else name_text(one) for one in sources or ())),
        rules=TimeRules(
            _find_common_pattern(time_pattern),
            None if utc_offset is None else parse_utc_offset(utc_offset, field="--utc-offset"),
        ),
        image_size=None if image_size is None else parse_image_size(image_size),
        method=parse_choice("--method", method, METHODS),
        options=CalibrationOptions(
            projection=stated_once("--projection", projection, (*PROJECTIONS, "auto")) or "auto",
            mirrored=stated_once("--mirrored", mirrored, get_args(Mirrored)),
            level_within_deg=level_within,
        ),
        clock_error_s=clock_error,
        calibration=calibration,
        stacks=True,
    )
    stated = (("latitude", latitude or calibration), ("longitude", longitude or calibration))
    missing = [name for name, given in stated if given is None]
    if cameras is None:
        plans = _make_plans(common, follow_exif=follow_exif)
    else:
        plans = read_cameras(cameras, common=common, required=missing, follow_exif=follow_exif)
    plans = _assign_patterns(plans, time_pattern or [])
    indexed = index_archive(plans)
    _confirm_cameras(indexed, yes=yes)
    options = ReanalysisOptions(
        target=target,
        store=store,
        workers=Workers(scheduler, workers or usable_processors()),
        exports=exports,
        provisional=provisional,
    )
    with progress_bars() as progress:
        summary = reanalyse(indexed, options, clock=SystemClock(), opened=_report_cluster, progress=progress)
    if as_json:
        print_json(summary.report)
    else:
        _print_summary(summary, target)
    epochs = [one["epochs"] for one in summary.report["cameras"]]
    if (
        indexed.refused
        or indexed.untimed
        or not all(
            of_camera and all(one["accepted"] or one["provisional"] for one in of_camera) for of_camera in epochs
        )
    ):
        raise typer.Exit(1)


def _choose_site(
    latitude: float | None, longitude: float | None, altitude: float, cameras: Path | None, calibration: Path | None
) -> Site:
    if latitude is None and longitude is None and calibration is not None:
        return read_calibration(calibration).site
    if (latitude is None or longitude is None) and cameras is None:
        missing = "--latitude" if latitude is None else "--longitude"
        raise InputError(field=missing, problem="missing", remedy="give it, or --cameras FILE that has it")
    return Site(latitude=latitude or 0.0, longitude=longitude or 0.0, altitude=altitude)


def _make_plans(common: CameraPlan, *, follow_exif: bool) -> list[CameraPlan]:
    """Return one camera for each source, by the source's name; sources that differ by their dates alone are one."""
    if not common.selector.sources:
        raise InputError(field="SOURCE", problem="missing", remedy="name a folder or archive, or give --cameras FILE")
    plans: dict[str, CameraPlan] = {}
    for undated, addresses in by_date(common.selector.sources):
        wanted = PurePosixPath(undated).name.partition(".")[0] or "camera"
        name = new_camera_name(wanted, taken=plans)
        selector = Selector(upright_addresses(addresses) if follow_exif else addresses)
        plans[name] = replace(common, name=name, selector=selector)
    return list(plans.values())


def _parse_camera_pattern(given: str) -> tuple[str, str]:
    """Return the camera that a pattern is for, "" for all, and the pattern."""
    name, equals, pattern = given.partition("=")
    camera, pattern = (name, pattern) if equals and "%" not in name else ("", given)
    return camera, checked_pattern(pattern, field="--time-pattern")


def _find_common_pattern(given: list[str] | None) -> str | None:
    """Return the pattern that is for all cameras."""
    found = [pattern for name, pattern in map(_parse_camera_pattern, given or []) if not name]
    if len(found) > 1:
        raise InputError(
            field="--time-pattern", problem="two patterns for all cameras", remedy="give CAMERA=PATTERN for each"
        )
    return found[0] if found else None


def _assign_patterns(plans: list[CameraPlan], given: Sequence[str]) -> list[CameraPlan]:
    """Return cameras with the patterns that are given for them."""
    patterns = {name: pattern for name, pattern in map(_parse_camera_pattern, given) if name}
    names = [plan.name for plan in plans]
    unknown = sorted(set(patterns) - set(names))
    if unknown:
        problem, remedy = f"{unknown[0]} is no camera", f"name one of {', '.join(names)}"
        raise InputError(field="--time-pattern", problem=problem, remedy=remedy)
    return [
        replace(plan, rules=plan.rules._replace(pattern=patterns[plan.name])) if plan.name in patterns else plan
        for plan in plans
    ]


def _confirm_cameras(indexed: Indexed, *, yes: bool) -> None:
    """Show whose the images are and how their times were read, and ask whether that is right.

    Raises
    ------
    InputError : the answer is no, or there is no terminal to ask at.
    """
    for one in indexed.cameras:
        width, height = one.size
        sources = one.plan.selector.sources
        of_days = f" in {len(sources)} sources by date" if len(sources) > 1 else ""
        nights = f" and {len(one.nights)} of the night" if one.nights else ""
        seen = f"{counted(len(one.images), 'image')}{nights} of {width}x{height} px{of_days}; times by {one.family}"
        print(f"camera {one.plan.name}: {seen}: {one.example[0]} is {one.example[1]}", file=sys.stderr)
    for failure in (*indexed.refused, *indexed.failures[:_LISTED]):
        print_sentence(f"left out {failure.file}: {failure.finding.sentence}", file=sys.stderr)
    if len(indexed.failures) > _LISTED:
        print(f"… and {len(indexed.failures) - _LISTED} more", file=sys.stderr)
    if yes or not indexed.cameras:
        return
    if not sys.stdin.isatty():
        raise InputError(
            field="--yes", problem="missing, and there is no terminal to confirm the times at", remedy="give it"
        )
    if not typer.confirm("Are cameras and times right?", err=True):
        raise InputError(
            field="times", problem="are not right", remedy="give --utc-offset, --time-pattern or --cameras"
        )


def _report_cluster(cluster: Cluster) -> None:
    place = cluster.workers.scheduler or f"{cluster.workers.n} processes, each ended at {WORKER_BYTES >> 20} MiB"
    print(f"workers: {place}; Dask's dashboard: {cluster.dashboard}", file=sys.stderr)


def _print_summary(summary: Summary, target: Path) -> None:
    rows: list[Sequence[object]] = []
    for one in summary.report["cameras"]:
        for finding in one["findings"]:
            print_sentence(f"{one['camera']}: {finding['reason']}")
        rows += [
            (
                f"{one['camera']} {epoch['epoch']}",
                epoch["cause"],
                f"{epoch['start'][:16]}\n{epoch['end'][:16]}",
                f"{epoch['clock_offset_s']:+.0f}",
                epoch["sightings"],
                significant(epoch["rmse_px"], 2),
                significant(epoch["sky_rms_deg"], 2),
                "yes" if epoch["accepted"] else "prov." if epoch["provisional"] else "no",
            )
            for epoch in one["epochs"]
        ]
    header = ("epoch", "cause", "from, to", "clock\ns", "suns", "RMSE\npx", "sky\n°", "ok")
    print_table(header, rows)
    for epoch in (epoch for one in summary.report["cameras"] for epoch in one["epochs"]):
        if not epoch["accepted"] and epoch["reasons"]:
            print_sentence(f"{epoch['camera']} {epoch['epoch']}: {epoch['reasons'][0]}")
    images, suns = (sum(one[key] for one in summary.report["cameras"]) for key in ("images", "accepted"))
    left_out = sum(summary.report["failures"].values())
    counts = (counted(images, "image"), counted(suns, "sun"), f"{counted(left_out, 'file')} left out")
    print(f"{', '.join(counts)}, {summary.report['seconds']:.0f} s")
    print(f"report: {target / 'report.html'}")
    if (headline := summary.report.get("headline")) is not None:
        print_sentence(f"{counted(headline['n'], 'file')} left out: {headline['reason']}")
