"""The owner of a folder, as whom a command of root acts until it has ended."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from sunarc.imager.archive.database.state_folder import as_owner

until_the_end = ExitStack()
"""Contexts that last until the command has ended, which closes them."""


def act_as_owner(folder: Path | None) -> Path | None:
    """Act as the owner of a folder until the command has ended, where root asks; return the folder."""
    if folder is not None:
        until_the_end.enter_context(as_owner(folder))
    return folder


def act_as_folder_owner(target: Path | None) -> Path | None:
    """Act as the owner of the folder that a file or folder is written into, where root asks; return the target."""
    if target is not None:
        act_as_owner(target if target.is_dir() else target.absolute().parent)
    return target
