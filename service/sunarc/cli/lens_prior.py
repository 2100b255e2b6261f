"""The parts of `sunarc calibrate` that are of several cameras: lens prior files and joint fits."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from rich.console import Console

from sunarc.calibration.lens_library.lens_type import LensType, UnitSpread
from sunarc.cli.output import print_json, table
from sunarc.errors import InputError
from sunarc.offline.calibrate_joint import calibrate_joint
from sunarc.offline.lens_priors import combined_lens, write_lens_prior
from sunarc.runtime.clock import SystemClock

_PANEL = "Cameras of one type of lens"
LensPriorFile = Annotated[
    Path | None,
    typer.Option("--lens-prior", help="What is known of this type of lens, a file.", rich_help_panel=_PANEL),
]
WriteLensPrior = Annotated[
    Path | None,
    typer.Option(
        "--write-lens-prior",
        help="Write what this calibration, and those of --lens-of, say of the type of lens.",
        rich_help_panel=_PANEL,
    ),
]
LensOf = Annotated[
    list[Path] | None,
    typer.Option(
        "--lens-of", help="A calibration document of another camera of the type; repeat it.", rich_help_panel=_PANEL
    ),
]
SpreadText = Annotated[
    str | None,
    typer.Option(
        "--unit-spread",
        metavar="F,C,R,D",
        help="1-sigma between units: focal length (relative), centre, radial, decentering (px).",
        rich_help_panel=_PANEL,
    ),
]
JointFile = Annotated[
    Path | None,
    typer.Option("--joint", metavar="SPEC.toml", help="Fit several cameras and epochs.", rich_help_panel=_PANEL),
]
JointFolder = Annotated[
    Path | None,
    typer.Option(
        "--output", "-o", help="Folder of the documents and the lens prior of --joint.", rich_help_panel=_PANEL
    ),
]


def known_lens(path: Path | None, *, start: Path | None, writes: bool) -> LensType | None:
    """Return the type of lens of a file; None without one."""
    if path is None:
        return None
    if start is not None:
        raise InputError(field="--lens-prior", problem="beside --start", remedy="give one of them")
    if writes:
        raise InputError(
            field="--write-lens-prior",
            problem="beside --lens-prior: the fit would count what the file says once more",
            remedy="fit without --lens-prior, and name the other cameras with --lens-of",
        )
    from sunarc.workers.calibrating.lens_prior_file import read_lens_prior

    return read_lens_prior(path)


class LensToWrite(NamedTuple):
    """Where a lens prior is written, None: nowhere; the other cameras' documents; the stated spread between units."""

    path: Path | None
    others: list[Path]
    spread: UnitSpread | None

    def write(self, documents: list[dict[str, Any]]) -> None:
        """Write what accepted calibrations say of their type of lens."""
        if self.path is None or not all(document["verdict"]["accepted"] for document in documents):
            return
        lens = combined_lens(documents, self.others, spread=self.spread)
        write_lens_prior(self.path, lens)
        typer.echo(f"lens prior of {len(lens.cameras)} cameras: {self.path}", err=True)


def parse_spread(text: str | None) -> UnitSpread | None:
    """Return the spread between units that F,C,R,D states."""
    if text is None:
        return None
    try:
        focal, center, radial, decentering = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(
            field="--unit-spread", problem=f"{text!r}", remedy="give four numbers, as 0.003,8,0.4,0.3"
        ) from None
    return UnitSpread(focal_length=focal, center_px=center, radial_px=radial, decentering_px=decentering)


def print_joint(spec: Path, folder: Path | None, *, as_json: bool) -> None:
    """Fit what a file asks for, and print one row an entry; exit 1 where one is refused."""
    if folder is None:
        raise InputError(field="--output", problem="missing beside --joint", remedy="name a folder")
    documents = calibrate_joint(spec, folder=folder, clock=SystemClock())
    if as_json:
        print_json(documents)
    else:
        rows = [
            [
                document["camera"],
                document["pose_epoch"],
                "accepted" if document["verdict"]["accepted"] else "refused",
                f"{document['uncertainty']['sky_rms_deg']:.4f}°",
                document["verdict"]["reasons"][-1 if document["verdict"]["accepted"] else 0],
            ]
            for document in documents
        ]
        Console(soft_wrap=True).print(table(("camera", "epoch", "verdict", "1-sigma over the sky", ""), rows))
    if not all(document["verdict"]["accepted"] for document in documents):
        raise typer.Exit(1)
