"""The commands of `sunarc hub`: parse, call, print."""

from __future__ import annotations

import secrets
from datetime import timedelta
from typing import Annotated

import typer

from sunarc.cli.options import AsJson, Config, hub_settings, print_json, print_rows, print_text
from sunarc.common.utc import rfc3339
from sunarc.hub.archive import open_hub_archive
from sunarc.hub.feed_routes import token_digest
from sunarc.hub.feed_schema import feed_schema
from sunarc.hub.nightly import cross_check_fleet
from sunarc.hub.nightly_store import CrossCheck
from sunarc.imager.archive.database.schema import head_revision
from sunarc.imager.runtime.clock import SystemClock

hub_cli = typer.Typer(no_args_is_help=True, help="The cameras of a fleet: register, list what was refused.")

Camera = Annotated[str, typer.Argument(metavar="CAMERA", help="Its name, the imager's setting `name`.")]
Installation = Annotated[str, typer.Argument(metavar="INSTALLATION", help="Its id, see `sunarc hub quarantine`.")]


@hub_cli.command()
def token(
    camera: Camera,
    config: Config = None,
    *,
    overlap: Annotated[float, typer.Option(help="Hours for which the camera's former tokens stay valid.")] = 168.0,
) -> None:
    """Register a camera, or renew its token: print a new one, of which the hub keeps the digest alone.

    Example: sunarc hub token roof --config /etc/sunarc/hub.toml > token
    """
    made, now = secrets.token_urlsafe(32), SystemClock().now()
    with open_hub_archive(hub_settings(config).archive) as archive:
        until = now + timedelta(hours=max(overlap, 0.0))
        archive.feeds.add_token(camera, token_digest(made), now=now, former_until=until)
    print(made)


@hub_cli.command()
def revoke(camera: Camera, config: Config = None) -> None:
    """End all tokens of a camera; exit 1 when it had none.

    Example: sunarc hub revoke roof --config /etc/sunarc/hub.toml
    """
    with open_hub_archive(hub_settings(config).archive) as archive:
        count = archive.feeds.end_tokens(camera, now=SystemClock().now())
    print(f"{count} tokens of {camera} ended")
    if not count:
        raise typer.Exit(1)


@hub_cli.command()
def accept(camera: Camera, installation: Installation, config: Config = None) -> None:
    """Take the rows that another installation sends under a camera's name, and no more those of the former one.

    Example: sunarc hub accept roof 5f1d0c --config /etc/sunarc/hub.toml
    """
    with open_hub_archive(hub_settings(config).archive) as archive:
        archive.feeds.accept_installation(camera, installation, now=SystemClock().now())
    print(f"installation {installation} sends as {camera} now")


@hub_cli.command()
def resend(camera: Camera, config: Config = None) -> None:
    """Have an imager send all its rows again, and clear the quarantine of its camera.

    Example: sunarc hub resend roof --config /etc/sunarc/hub.toml
    """
    with open_hub_archive(hub_settings(config).archive) as archive:
        archive.feeds.ask_again(camera)
    print(f"{camera} is asked for all its rows when it next sends")


@hub_cli.command()
def quarantine(config: Config = None, *, as_json: AsJson = False) -> None:
    """Print the rows that the hub refused or set apart, the newest first; exit 1 when there are some.

    Example: sunarc hub quarantine --config /etc/sunarc/hub.toml
    """
    with open_hub_archive(hub_settings(config).archive) as archive:
        found = archive.feeds.quarantine()
    names = ("camera", "installation", "reason", "seq", "kind", "n", "text")
    rows = [{name: getattr(one, name) for name in names} | {"last_at": rfc3339(one.last_at)} for one in found]
    cells = [[str(cell) for cell in row.values()] for row in rows]
    print_rows(rows, (*names, "last"), cells, as_json=as_json)
    if rows:
        raise typer.Exit(1)


@hub_cli.command()
def schema() -> None:
    """Print the JSON Schema of a line that an imager sends, as docs/feed.schema.json.

    Example: sunarc hub schema > feed.schema.json
    """
    print_json(feed_schema(head_revision()))


@hub_cli.command("cross-checks")
def cross_checks(config: Config = None, *, as_json: AsJson = False) -> None:
    """Print the clock, longitude and north of each camera by its neighbours; exit 1 when something is wrong.

    A camera that turns slowly, as a mast that settles does, is named, and is not wrong. Reads the last 60 days: some
    seconds a camera.

    Example: sunarc hub cross-checks --config /etc/sunarc/hub.toml
    """
    with open_hub_archive(hub_settings(config).archive) as archive:
        checks = cross_check_fleet(archive, now=SystemClock().now())
    print_text([one.as_json() for one in checks], "\n".join(map(_format_cross_check, checks)), as_json=as_json)
    if any(one.alarms for one in checks):
        raise typer.Exit(1)


def _format_cross_check(one: CrossCheck) -> str:
    since = "" if one.since is None else f" since {one.since.isoformat()}"
    sizes = (
        ("clock", one.clock_s, one.clock_sigma_s, " s"),
        ("or longitude", one.longitude_deg, one.longitude_sigma_deg, "°"),
        ("north", one.north_deg, one.north_sigma_deg, "°"),
        ("clock by clouds", one.cloud_clock_s, one.cloud_clock_sigma_s, " s"),
    )
    sure = "" if one.confidence is None else f", {one.agreeing} neighbours agree, probability {one.confidence:.2f}"
    shown = [
        f"{name} {size:.3g} ± {sigma:.2g}{unit}"
        for name, size, sigma, unit in sizes
        if size is not None and sigma is not None
    ]
    beside = f"{one.n_days} days beside {', '.join(one.neighbours)}"
    return f"{one.camera}: {', '.join(one.found) or 'nothing'}{since}{sure}; " + "; ".join([*shown, beside])
