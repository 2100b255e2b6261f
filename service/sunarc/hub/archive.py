"""Archive of a hub: that of an imager, the rows that imagers send, and the results of the nightly work."""

from __future__ import annotations

from pathlib import Path

from sqlalchemy import URL, Engine

from sunarc.hub.feeds import FeedStore
from sunarc.hub.nightly_store import NightlyStore
from sunarc.imager.archive.archive import Archive, open_database
from sunarc.imager.archive.database.connections import DatabaseFile


class HubArchive(Archive):
    """The database of a fleet as its parts.

    Attributes
    ----------
    feeds : rows that imagers send, their tokens, and the rows that were refused.
    nightly : summaries of solar days, cross-checks, and the runs of the nightly work.
    """

    def __init__(self, engine: Engine, file: DatabaseFile | None) -> None:
        super().__init__(engine, file)
        self.feeds = FeedStore(self.database)
        self.nightly = NightlyStore(self.database)


def open_hub_archive(store: Path | URL, *, upgrade_command: str | None = None) -> HubArchive:
    """Open a database as a hub's archive (`open_database`)."""
    return open_database(HubArchive, store, upgrade_command=upgrade_command)
