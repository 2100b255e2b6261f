"""The command line: parse, call, print. Exit codes: 0 done, 1 the answer is no, 2 usage, 3 something outside failed.

A command's module is loaded when the command is called, with the libraries that it needs and no others.
"""

from __future__ import annotations

import io
import sys
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_group

from sunarc import __version__
from sunarc.cli.commands import Command
from sunarc.cli.owner import until_the_end
from sunarc.common.errors import ConfigurationError, InputError, OutsideError, SunarcError
from sunarc.common.extras import missing_packages, require_extra
from sunarc.imager.runtime.child_process import one_thread_each

_LIBRARY = "library"


@cache
def houses() -> dict[str, dict[str, Command]]:
    """Return the commands of the library, and of each house by the extra that brings its dependencies.

    Raises
    ------
    ConfigurationError
        Where none is registered: the package was changed after it was installed.
    """
    found = sorted(entry_points(group="sunarc.commands"), key=lambda point: (point.name != _LIBRARY, point.name))
    if not found:
        raise ConfigurationError(
            "the installed package registers no command; install it again (of a checkout: deploy/setup)"
        )
    return {point.name: point.load() for point in found}


class _Commands(TyperGroup):
    """Commands that are known by name and first sentence, and loaded when they are called."""

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:  # noqa: ANN401 - click's
        """Return the name of the command that is called, the command itself, and the arguments that follow."""
        name, known, rest = super().resolve_command(ctx, args)
        return name, known if name is None else load_command(name), rest

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401, ARG002 - click's
        """Write the commands of each house, and whether it is installed."""
        for house, commands in houses().items():
            with formatter.section(_make_heading(house)):
                formatter.write_dl([(name, one.help) for name, one in commands.items() if not one.hidden])


def _make_heading(house: str) -> str:
    if house == _LIBRARY:
        return "Commands"
    return f"Commands of sunarc[{house}]" + (", which is not installed" if missing_packages(house) else "")


def load_command(name: str) -> Any:  # noqa: ANN401 - click's command
    """Return a command with its options.

    Raises
    ------
    InputError
        Where its house is not installed; the remedy is the line that installs it.
    """
    house = next(house for house, commands in houses().items() if name in commands)
    require_extra(house, what=name)
    command = houses()[house][name]
    found = getattr(import_module(command.module), command.name)
    alone = _new_group(TyperGroup)
    if isinstance(found, typer.Typer):
        alone.add_typer(found, name=name)
    else:
        alone.command(name)(found)
    loaded = get_group(alone).commands[name]
    _keep_whole_summaries(loaded)
    return loaded


_WHOLE = 1000
"""Longest summary, characters: longer than any."""


def _keep_whole_summaries(command: Any) -> None:  # noqa: ANN401 - click's command
    """Let the help of a group show the whole first sentence of each command."""
    for one in getattr(command, "commands", {}).values():
        one.short_help = one.get_short_help_str(_WHOLE)
        _keep_whole_summaries(one)


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


@cache
def _new_command_line() -> typer.Typer:
    """Return the command line, with the name and the first sentence of each command."""
    cli = _new_group(_Commands)
    cli.callback(invoke_without_command=True)(version)
    for commands in houses().values():
        for name, command in commands.items():
            cli.command(name, help=command.help)(lambda: None)
    return cli


def main() -> None:
    """Run the command line; every expected failure is one line on standard error."""
    one_thread_each()
    for stream in (sys.stdout, sys.stderr):  # a name of bytes that are no text ends no command
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        with until_the_end:
            _new_command_line()(standalone_mode=True)
    except (InputError, ConfigurationError) as error:
        _exit_with_error(error, 2)
    except SunarcError as error:
        _exit_with_error(error, 3)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(3)
    except PermissionError as error:
        _exit_with_error(
            OutsideError(f"{error.filename} is not for this user; ask as root, or as the service's user"), 3
        )


def _exit_with_error(error: Exception, code: int) -> None:
    print(f"sunarc: {error}", file=sys.stderr)
    sys.exit(code)


def version(*, show: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False) -> None:
    """Print the version when asked."""
    if show:
        print(f"sunarc {__version__}")
        raise typer.Exit
