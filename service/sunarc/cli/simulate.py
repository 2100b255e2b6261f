"""The command `sunarc simulate`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sunarc.cli.options import Altitude, Latitude, Longitude
from sunarc.cli.owner import act_as_folder_owner
from sunarc.common.errors import InputError
from sunarc.common.utc import parse_time
from sunarc.imager.runtime.log_to_journal import start_log
from sunarc.sky.site import Site, parse_angle

if TYPE_CHECKING:
    from sunarc.lab.simulation.serving import Bump


def simulate(
    *,
    address: Annotated[str, typer.Option(help="Loopback address to answer at.")] = "127.0.0.1",
    start: Annotated[str, typer.Option(help="First simulated time, ISO 8601.")] = "2013-05-13T12:00:00Z",
    speed: Annotated[float, typer.Option(help="Times faster than real.")] = 1.0,
    latitude: Latitude = "36.604043",
    longitude: Longitude = "-97.484856",
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
    folder: Annotated[
        Path | None,
        typer.Option(
            callback=act_as_folder_owner,
            help="Write a picture a minute here instead, as another program's camera does.",
        ),
    ] = None,
    http: Annotated[
        str | None, typer.Option(help="Give the present picture at ADDRESS:PORT instead, as Mobotix and Axis do.")
    ] = None,
    token_file: Annotated[
        Path | None, typer.Option(help="With --http: ask for the USER:PASSWORD in this file, as Digest or Basic.")
    ] = None,
    bump: Annotated[
        float | None, typer.Option(metavar="DEG", help="Turn the camera by so much about the east, at the time --at.")
    ] = None,
    at: Annotated[str | None, typer.Option("--at", metavar="TIME", help="When, simulated time, ISO 8601.")] = None,
    cadence: Annotated[float, typer.Option(help="Simulated seconds between the pictures of --folder.")] = 60.0,
    truth: Annotated[
        Path | None,
        typer.Option(callback=act_as_folder_owner, help="Write the true camera here, a calibration document."),
    ] = None,
) -> None:
    """Run a simulated imager that speaks GigE Vision on loopback; SIGUSR1 halves the speed of its clock.

    With --folder a camera whose program writes its pictures into a folder, in UTC; with --http one that answers with
    its present picture at /record/current.jpg and /axis-cgi/jpg/image.cgi; the nights are skipped.

    With --bump and --at the camera is moved, as a rehearsal (docs/operating/rehearse.md).

    Example: sunarc simulate --address 127.0.0.1 --speed 60 --truth truth.json
    """
    from sunarc.lab.simulation import serving as simulating
    from sunarc.lab.simulation.serving import ImagerOptions, SceneOptions, SensorModel, SimulatedNight

    answers_at = None if http is None else _parse_address(http, other=folder)
    start_log(os.environ)
    site = Site(
        latitude=parse_angle(latitude, question="--latitude", axis="NS"),
        longitude=parse_angle(longitude, question="--longitude", axis="EW"),
        altitude=altitude,
    )
    first = parse_time(start, where="--start")
    moved = None if bump is None and at is None else _parse_bump(bump, at)
    pictures = simulating.PictureOptions(
        start=first, speed=speed, cadence_s=cadence, site=site, truth=truth, bump=moved
    )
    if folder is not None:
        simulating.simulate_pictures(pictures, folder)
        return
    if answers_at is not None:
        simulating.simulate_http(pictures, answers_at, login=token_file)
        return
    scene = SceneOptions(
        nd_transmission=nd_transmission,
        ghost_strength=ghost,
        sun_cover=sun_cover,
        moon_at=moon,
        night=SimulatedNight() if nights else None,
        bump=moved,
    )
    options = ImagerOptions(
        address=address,
        start=first,
        speed=speed,
        skip_nights=not nights,
        site=site,
        lens_seed=lens_seed,
        clouds=clouds,
        scene=scene,
        sensor=SensorModel(blooming=blooming),
        truth=truth,
    )
    simulating.simulate_imager(options)


def _parse_bump(degrees: float | None, at: str | None) -> Bump:
    """Return the bump that --bump and --at state together."""
    from sunarc.lab.simulation.serving import Bump

    if degrees is None or at is None:
        missing = "--bump" if degrees is None else "--at"
        raise InputError(field=missing, problem="missing", remedy="give both, as --bump 2.5 --at 2013-05-15T18:00:00Z")
    if not 0.0 < abs(degrees) <= _LARGEST_BUMP_DEG:
        problem = f"{degrees:g} degrees is not within 0 to {_LARGEST_BUMP_DEG:g}"
        raise InputError(field="--bump", problem=problem, remedy="give a turn, as --bump 2.5")
    return Bump(at=parse_time(at, where="--at"), turn_deg=(degrees, 0.0, 0.0))


_LARGEST_BUMP_DEG = 45.0


def _parse_address(text: str, *, other: Path | None) -> tuple[str, int]:
    if other is not None:
        raise InputError(field="--http", problem="stands beside --folder", remedy="give one of them")
    host, _, port = text.rpartition(":")
    if not host or not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
        raise InputError(field="--http", problem=f"{text!r} is not ADDRESS:PORT", remedy="give one as 127.0.0.1:8090")
    return host, int(port)
