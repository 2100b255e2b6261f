"""The commands of a service: `sunarc serve`, `check`, `compile` and `settings`."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from sunarc.cli.options import (
    AsJson,
    Config,
    hub_settings,
    parse_choice,
    print_json,
    print_rows,
    service_settings,
)
from sunarc.common.extras import require_extra
from sunarc.imager.runtime.clock import SystemClock
from sunarc.imager.runtime.log_to_journal import start_log
from sunarc.imager.settings.load import load_settings
from sunarc.imager.settings.reference import all_settings, as_markdown


def serve(
    config: Config = None,
    *,
    role: Annotated[str, typer.Option(help="imager; or hub: imagers send it their archives.")] = "imager",
) -> None:
    """Run the service until SIGTERM or SIGINT.

    Example: sunarc serve --config /etc/sunarc/sunarc.toml
    """
    from sunarc.imager.app.serving import end_process

    is_hub = parse_choice("--role", role, ("imager", "hub")) == "hub"
    start_log(os.environ)
    end_process(_serve_hub(config) if is_hub else _serve_imager(config))


def _serve_hub(config: Path | None) -> int:
    require_extra("hub", what="serve --role hub")
    from sunarc.hub.serving import serve_hub

    return serve_hub(hub_settings(config))


def _serve_imager(config: Path | None) -> int:
    from sunarc.imager.app.serving import serve_imager

    settings = service_settings(config)
    if settings.source != "folder":
        return serve_imager(settings)
    from sunarc.archives.ingest import ingest_followed

    return serve_imager(settings, folder_analysis=ingest_followed)


def check(
    config: Config = None,
    *,
    camera: Annotated[bool, typer.Option("--camera", help="Look at the camera alone, closely.")] = False,
    as_json: AsJson = False,
) -> None:
    """Check the needs of the service: disk, database, port, clock, camera, files, receivers; exit 1 if one fails.

    Example: sunarc check --camera --config /etc/sunarc/sunarc.toml
    """
    from sunarc.imager.checks import init_option, run_camera_checks, run_checks

    run = run_camera_checks if camera else run_checks
    results = list(run(load_settings(config), clock=SystemClock()))
    rows = [[result.outcome, result.what, escape(result.text)] for result in results]
    record = [{**result._asdict(), "question": init_option(result)} for result in results]
    print_rows(record, ("", "", ""), rows, as_json=as_json)
    asked = [f"{result.what} ({question})" for result in results if (question := init_option(result)) is not None]
    if asked and not as_json:
        print(f"sunarc init {'FILE' if config is None else config} asks again: {'; '.join(asked)}")
    if any(result.outcome == "fail" for result in results):
        raise typer.Exit(1)


def compile_kernels(
    *,
    first_sighting: Annotated[bool, typer.Option("--first-sighting", help="As before 0.4; no effect.")] = False,
) -> None:
    """Do nothing: the kernels are compiled where the package is built. Kept for scripts of versions before 0.4.

    Example: sunarc compile
    """
    del first_sighting
    print("nothing to compile: the package holds its kernels compiled")


def settings(*, as_json: AsJson = False) -> None:
    """Print every setting with its default, its bounds and its meaning, as the page docs/settings.md.

    Example: sunarc settings --json
    """
    if as_json:
        print_json([asdict(setting) for setting in all_settings()])
    else:
        print(as_markdown(), end="")
