"""The command line: parse, call, print. Exit codes: 0 done, 1 the answer is no, 2 usage, 3 something outside failed.

A command's module is loaded when the command is called, with the libraries that it needs and no others.
"""

from __future__ import annotations

import importlib
import io
import sys
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperGroup
from typer.main import get_group

from sunarc import __version__
from sunarc.common.errors import ConfigurationError, InputError, OutsideError, SunarcError
from sunarc.imager.archive.database.state_folder import until_the_end
from sunarc.imager.runtime.child_process import one_thread_each


class _Command(NamedTuple):
    """Where a command is, or a group of commands: its module in `cli/` and its name there; what `--help` says of it."""

    module: str
    name: str
    help: str


COMMANDS = {name: _Command(*rest) for name, *rest in (
    ("calibrate", "calibrate", "calibrate",
     "Fit the camera to sightings; exit 1 when the fit is refused, or --again leads to another camera."),
    ("ingest", "ingest", "ingest",
     "Find the sun in a folder of archived images and fill the archive; images that are in it are skipped."),
    ("export", "documents", "export_calibration",
     "Write a calibration in another format; its approximation error goes to standard error."),
    ("compare", "documents", "compare",
     "Compare two cameras: differences of B from A over the sky, in px and degrees."),
    ("rectify", "documents", "rectify",
     "Map images to a grid of the sky, or of the ground for clouds at a height; north at the top, east at the right."),
    ("stars", "stars", "stars",
     "Detect and identify stars in images of the night; exit 1 when none matches, or one is of another site."),
    ("reanalyse", "reanalyse", "reanalyse_archive",
     "Find the sun in an archive of images, the pose epochs of its cameras, and a calibration for each."),
    ("init", "init", "init",
     "Ask for what cannot be known, try the rest, and write a settings file; exit 1 where a trial fails."),
    ("serve", "service", "serve", "Run the service until SIGTERM or SIGINT."),
    ("compile", "service", "compile_kernels",
     "Do nothing: the kernels are compiled where the package is built. Kept for scripts of versions before 0.4."),
    ("simulate", "service", "simulate",
     "Run a simulated imager that speaks GigE Vision on loopback; SIGUSR1 halves the speed of its clock."),
    ("detect", "pixels", "detect", "Find the sun in images; exit 1 when none shows it, 2 when none is an image."),
    ("project", "pixels", "project", "Read zenith_deg,azimuth_deg from standard input and write their pixels."),
    ("unproject", "pixels", "unproject", "Read x_px,y_px from standard input and write their directions."),
    ("codes", "codes", "codes", "Print every code of findings with its meaning and action, as the page docs/codes.md."),
    ("settings", "service", "settings",
     "Print every setting with its default, its bounds and its meaning, as the page docs/settings.md."),
    ("check", "service", "check",
     "Check what the service needs: disk, database, port, clock, camera, files, receivers; exit 1 when a check fails."),
    ("points", "database", "points_cli", "Import and export sightings as CSV."),
    ("db", "database", "db_cli", "The archive's database."),
    ("calibrations", "calibrations", "calibrations_cli", "The history of calibrations: list, roll back, pin."),
    ("epochs", "calibrations", "epochs_cli",
     "The pose epochs (intervals in which the camera does not move): list, close a wrong one."),
    ("hub", "hub", "hub_cli", "The cameras of a fleet: register, list what was refused."),
    ("study", "study", "study_cli", "Reproduce the paper's tables and figures; errors of cloud shadows."),
)}  # fmt: skip


class _Commands(TyperGroup):
    """Commands that are known by name and first sentence, and loaded when they are called."""

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:  # noqa: ANN401 - click's
        """Return the name of the command that is called, the command itself, and the arguments that follow."""
        name, known, rest = super().resolve_command(ctx, args)
        return name, known if name is None else _loaded(name), rest


def _loaded(name: str) -> Any:  # noqa: ANN401 - click's command
    """Return a command with its options."""
    module, attribute, _ = COMMANDS[name]
    found = getattr(importlib.import_module(f"sunarc.cli.{module}"), attribute)
    alone = _new_group(TyperGroup)
    if isinstance(found, typer.Typer):
        alone.add_typer(found, name=name)
    else:
        alone.command(name)(found)
    return get_group(alone).commands[name]


def _new_group(cls: type[TyperGroup]) -> typer.Typer:
    """Return a group of commands, with plain help texts and tracebacks."""
    return typer.Typer(
        cls=cls,
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        help="Keeps the geometric calibration of an all-sky imager right, from the sun and the stars.",
    )


cli = _new_group(_Commands)
for _name, _command in COMMANDS.items():
    cli.command(_name, help=_command.help)(lambda: None)


def main() -> None:
    """Run the command line; every expected failure is one line on standard error."""
    one_thread_each()
    for stream in (sys.stdout, sys.stderr):  # a name of bytes that are no text ends no command
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        with until_the_end:
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
