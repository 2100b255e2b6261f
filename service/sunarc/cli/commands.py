"""Commands of the library and of each house, registered in `pyproject.toml` as entry points of `sunarc.commands`.

A house's entry point has the name of the extra that brings what its commands need; the library's commands need none.
"""

from __future__ import annotations

from typing import NamedTuple


class Command(NamedTuple):
    """Where a command, or a group of commands, is: its module and its name there; its `--help` text, unless hidden."""

    module: str
    name: str
    help: str
    hidden: bool = False


_HIDDEN = {"compile"}
"""Commands that are kept for scripts of former versions."""

LIBRARY = {name: Command(module, attribute, text) for name, module, attribute, text in (
    ("calibrate", "sunarc.cli.calibrate", "calibrate",
     "Fit the camera to sightings; exit 1 when the fit is refused, or --again leads to another camera."),
    ("detect", "sunarc.cli.pixels", "detect",
     "Find the sun in images; exit 1 when none shows it, 2 when none is an image."),
    ("stars", "sunarc.cli.stars", "stars",
     "Detect and identify stars in images of the night; exit 1 when none matches, or one is of another site."),
    ("mask", "sunarc.cli.mask", "mask",
     "Find the obstructions of the sky, and the horizon, in images of a clear day or more."),
    ("project", "sunarc.cli.pixels", "project",
     "Read zenith_deg,azimuth_deg from standard input and write their pixels."),
    ("unproject", "sunarc.cli.pixels", "unproject",
     "Read x_px,y_px from standard input and write their directions."),
    ("export", "sunarc.cli.documents", "export_calibration",
     "Write a calibration in another format; its approximation error goes to standard error."),
    ("compare", "sunarc.cli.documents", "compare",
     "Compare two cameras: differences of B from A over the sky, in px and degrees."),
    ("rectify", "sunarc.cli.documents", "rectify",
     "Map images to a grid of the sky, seen from below, or of the ground for clouds at a height; north at the top."),
    ("codes", "sunarc.cli.codes", "codes",
     "Print every code of findings with its meaning and action, as the page docs/codes.md."),
)}  # fmt: skip

IMAGER = {name: Command(module, attribute, text, name in _HIDDEN) for name, module, attribute, text in (
    ("init", "sunarc.cli.init", "init",
     "Ask for the site and the source, try the rest, and write a settings file; exit 1 where a trial fails."),
    ("serve", "sunarc.cli.service", "serve", "Run the service until SIGTERM or SIGINT."),
    ("check", "sunarc.cli.service", "check",
     "Check the needs of the service: disk, database, port, clock, camera, files, receivers; exit 1 if one fails."),
    ("settings", "sunarc.cli.service", "settings",
     "Print every setting with its default, its bounds and its meaning, as the page docs/settings.md."),
    ("ingest", "sunarc.cli.ingest", "ingest",
     "Find the sun in a folder of archived images and fill the archive; images that are in it are skipped."),
    ("points", "sunarc.cli.database", "points_cli", "Import and export sightings as CSV."),
    ("db", "sunarc.cli.database", "db_cli", "The archive's database."),
    ("calibrations", "sunarc.cli.calibrations", "calibrations_cli",
     "The history of calibrations: list, roll back, pin."),
    ("epochs", "sunarc.cli.calibrations", "epochs_cli",
     "The pose epochs (intervals in which the camera does not move): list, close a wrong one."),
    ("compile", "sunarc.cli.service", "compile_kernels",
     "Do nothing: the kernels are compiled where the package is built. Kept for scripts of versions before 0.4."),
)}  # fmt: skip

ARCHIVES = {
    "reanalyse": Command(
        "sunarc.cli.reanalyse",
        "reanalyse_archive",
        "Find the sun in an archive of images, the pose epochs of its cameras, and a calibration for each.",
    ),
}

HUB = {
    "hub": Command("sunarc.cli.hub", "hub_cli", "The cameras of a fleet: register, list what was refused."),
}

LAB = {
    "simulate": Command(
        "sunarc.cli.simulate",
        "simulate",
        "Run a simulated imager that speaks GigE Vision on loopback; SIGUSR1 halves the speed of its clock.",
    ),
    "study": Command(
        "sunarc.cli.study", "study_cli", "Reproduce the paper's tables and figures; errors of cloud shadows."
    ),
}
