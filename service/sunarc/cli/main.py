"""The command line: parse, call, print. Exit codes: 0 done, 1 the answer is no, 2 usage, 3 something outside failed."""

from __future__ import annotations

import os
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from sunarc import __version__, app
from sunarc.cli.calibrate import calibrate
from sunarc.cli.calibrations import calibrations_cli, epochs_cli
from sunarc.cli.codes import all_codes, codes_as_markdown
from sunarc.cli.compare import compare
from sunarc.cli.database import db_cli, points_cli
from sunarc.cli.export import export_calibration
from sunarc.cli.hub import hub_cli
from sunarc.cli.ingest import ingest
from sunarc.cli.options import (
    Altitude,
    AsJson,
    CalibrationFile,
    Config,
    DetectionMethod,
    Latitude,
    Longitude,
    choice_of,
)
from sunarc.cli.output import print_json, table
from sunarc.cli.reanalyse import reanalyse_archive
from sunarc.cli.rectify import rectify
from sunarc.cli.stars import stars
from sunarc.cli.study import study_cli
from sunarc.detection import BAYERS
from sunarc.diagnostics import checks
from sunarc.errors import ConfigurationError, InputError, OutsideError, SunarcError
from sunarc.jit import set_aside_after_death
from sunarc.offline.compile_kernels import compile_kernels as compile_all
from sunarc.offline.detect_files import METHODS, detect_in_files, draw_overlay
from sunarc.offline.project_files import project_csv, unproject_csv
from sunarc.runtime.clock import SystemClock
from sunarc.runtime.log_to_journal import start_log
from sunarc.settings import all_settings, as_markdown, load_hub_settings, load_settings
from sunarc.sky import Site
from sunarc.utc import parse_time

cli = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Keeps the geometric calibration of an all-sky imager right, from the sun and the stars.",
)
cli.add_typer(points_cli, name="points")
cli.add_typer(db_cli, name="db")
cli.add_typer(calibrations_cli, name="calibrations")
cli.add_typer(epochs_cli, name="epochs")
cli.add_typer(hub_cli, name="hub")
cli.add_typer(study_cli, name="study")
cli.command()(calibrate)
cli.command()(ingest)
cli.command("export")(export_calibration)
cli.command()(compare)
cli.command()(rectify)
cli.command()(stars)
cli.command("reanalyse")(reanalyse_archive)

_out = Console(soft_wrap=True)


def main() -> None:
    """Run the command line; every expected failure is one line on standard error."""
    try:
        cli(standalone_mode=True)
    except (InputError, ConfigurationError) as error:
        _fail(error, 2)
    except SunarcError as error:
        _fail(error, 3)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(3)
    except PermissionError as error:
        _fail(OutsideError(f"{error.filename} is not for this user; ask as root, or as the service's user"), 3)


def _fail(error: Exception, code: int) -> None:
    print(f"sunarc: {error}", file=sys.stderr)
    sys.exit(code)


@cli.callback(invoke_without_command=True)
def version(*, show: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False) -> None:
    """Print the version when asked."""
    if show:
        print(f"sunarc {__version__}")
        raise typer.Exit


@cli.command()
def serve(
    config: Config = None,
    *,
    role: Annotated[str, typer.Option(help="imager; or hub: imagers send it their archives.")] = "imager",
) -> None:
    """Run the service until SIGTERM or SIGINT.

    Example: sunarc serve --config /etc/sunarc/sunarc.toml
    """
    is_hub = choice_of("--role", role, ("imager", "hub")) == "hub"
    start_log(os.environ)
    set_aside_after_death()
    app.end_process(app.serve_hub(load_hub_settings(config)) if is_hub else app.serve(load_settings(config)))


@cli.command("compile")
def compile_kernels(
    *,
    first_sighting: Annotated[
        bool, typer.Option("--first-sighting", help="Without those of the fit, which take most of the time.")
    ] = False,
) -> None:
    """Compile the numerical kernels into numba's cache, so that the service's first sighting and first fit find them.

    Example: sunarc compile
    """
    compile_all(first_sighting_alone=first_sighting)


@cli.command()
def simulate(
    *,
    address: Annotated[str, typer.Option(help="Loopback address to answer at.")] = "127.0.0.1",
    start: Annotated[str, typer.Option(help="First simulated time, ISO 8601.")] = "2013-05-13T12:00:00Z",
    speed: Annotated[float, typer.Option(help="Times faster than real.")] = 1.0,
    latitude: Latitude = 36.604043,
    longitude: Longitude = -97.484856,
    altitude: Altitude = 318.0,
    lens_seed: Annotated[int, typer.Option(help="Draws another true camera; 0 is the paper's.")] = 0,
    clouds: Annotated[str, typer.Option(help="clear, veil, broken, overcast; by commas: one a day.")] = "clear",
    nd_transmission: Annotated[
        float, typer.Option(help="Of a neutral filter before the lens; 0.01 unsaturates.")
    ] = 1.0,
    ghost: Annotated[float, typer.Option(help="Reflection opposite the sun, over the sun's brightness.")] = 0.0,
    sun_cover: Annotated[float, typer.Option(help="Share of the sun's diameter behind an edge.")] = 0.0,
    blooming: Annotated[float, typer.Option(help="Share of a full well's excess that runs along its column.")] = 0.0,
    moon: Annotated[
        tuple[float, float] | None, typer.Option(help="A full moon that stays there: zenith angle, azimuth in degrees.")
    ] = None,
    nights: Annotated[
        bool, typer.Option("--nights", help="Show the nights, with stars and moon; else skip them.")
    ] = False,
    truth: Annotated[Path | None, typer.Option(help="Write the true camera here, a calibration document.")] = None,
) -> None:
    """Run a simulated imager that speaks GigE Vision on loopback; SIGUSR1 halves the speed of its clock.

    Example: sunarc simulate --address 127.0.0.1 --speed 60 --truth truth.json
    """
    start_log(os.environ)
    scene = app.SceneOptions(
        nd_transmission=nd_transmission,
        ghost_strength=ghost,
        sun_cover=sun_cover,
        moon_at=moon,
        night=app.NightOptions() if nights else None,
    )
    options = app.ImagerOptions(
        address=address,
        start=parse_time(start, where="--start"),
        speed=speed,
        skip_nights=not nights,
        site=Site(latitude=latitude, longitude=longitude, altitude=altitude),
        lens_seed=lens_seed,
        clouds=clouds,
        scene=scene,
        sensor=app.SensorModel(blooming=blooming),
        truth=truth,
    )
    app.simulate(options)


@cli.command()
def detect(
    images: Annotated[list[Path], typer.Argument(help="Image files.")],
    *,
    method: DetectionMethod = "auto",
    full_scale: Annotated[int | None, typer.Option(help="Largest count; judged from the file unless given.")] = None,
    bayer: Annotated[str | None, typer.Option(help="Colours of a raw mosaic: RGGB, BGGR, GRBG or GBRG.")] = None,
    overlay: Annotated[Path | None, typer.Option(help="Write the (one) image with a cross on the sun.")] = None,
    as_json: AsJson = False,
) -> None:
    """Find the sun in images; exit 1 when none shows it, 2 when none is an image.

    Example: sunarc detect noon.png --json
    """
    if overlay is not None and len(images) != 1:
        raise InputError(field="--overlay", problem=f"{len(images)} images", remedy="give one image with it")
    mosaic = None if bayer is None else choice_of("--bayer", bayer, BAYERS)
    found = detect_in_files(images, method=choice_of("--method", method, METHODS), full_scale=full_scale, bayer=mosaic)
    if as_json:
        print_json(found)
    else:
        columns = ("file", "x_px", "y_px", "sigma_px", "method", "verdict", "reason")
        _out.print(table(columns, [[row[column] for column in columns] for row in found]))
    unread = [row for row in found if row["verdict"] == "no_frame"]
    for row in unread:
        print(f"sunarc: {row['reason']}", file=sys.stderr)
    if len(unread) == len(found):
        raise typer.Exit(2)
    if overlay is not None:
        draw_overlay(images[0], found[0], overlay)
    if not any(row["accepted"] for row in found):
        raise typer.Exit(1)


@cli.command()
def project(calibration: CalibrationFile) -> None:
    """Read zenith_deg,azimuth_deg from standard input and write where they land in the image.

    Example: sunarc project --calibration calibration.json < directions.csv
    """
    project_csv(calibration, sys.stdin, sys.stdout)


@cli.command()
def unproject(calibration: CalibrationFile) -> None:
    """Read x_px,y_px from standard input and write the directions that they look at.

    Example: sunarc unproject --calibration calibration.json < pixels.csv
    """
    unproject_csv(calibration, sys.stdin, sys.stdout)


@cli.command()
def codes(*, as_json: AsJson = False) -> None:
    """Print every code of findings with its meaning and action, as the page docs/codes.md.

    Example: sunarc codes --json
    """
    if as_json:
        print_json([one._asdict() for one in all_codes()])
    else:
        print(codes_as_markdown(all_codes()), end="")


@cli.command()
def settings(*, as_json: AsJson = False) -> None:
    """Print every setting with its default, its bounds and its meaning, as the page docs/settings.md.

    Example: sunarc settings --json
    """
    if as_json:
        print_json([asdict(setting) for setting in all_settings()])
    else:
        print(as_markdown(), end="")


@cli.command()
def check(
    config: Config = None,
    *,
    camera: Annotated[bool, typer.Option("--camera", help="Look at the camera alone, closely.")] = False,
    as_json: AsJson = False,
) -> None:
    """Try what the service needs: disk, database, port, clock, camera, files, receivers; exit 1 when something fails.

    Example: sunarc check --camera --config /etc/sunarc/sunarc.toml
    """
    run = checks.run_camera_checks if camera else checks.run_checks
    results = list(run(load_settings(config), clock=SystemClock()))
    if as_json:
        print_json([result._asdict() for result in results])
    else:
        _out.print(table(("", "", ""), [[result.outcome, result.what, escape(result.text)] for result in results]))
    if any(result.outcome == "fail" for result in results):
        raise typer.Exit(1)
