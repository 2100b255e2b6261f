"""Owner and mode of files that a command writes into another user's state folder."""

from __future__ import annotations

import os
from pathlib import Path

PRIVATE = 0o640
"""Mode of a copy of the database: its owner, and the group for backups."""


def give_to_owner_of(folder: Path, path: Path) -> None:
    """Set a file's owner and group to those of a folder, where this process may (root does).

    A file made by root in the service's state folder could not be written by the service.
    """
    if os.geteuid() != 0:
        return
    owner = folder.stat()
    os.chown(path, owner.st_uid, owner.st_gid)
