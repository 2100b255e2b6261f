"""Closing a pose epoch that was opened by mistake, and serving again what was served before it."""

from __future__ import annotations

from datetime import datetime
from itertools import pairwise

from sqlalchemy import Connection, select, update

from sunarc.archive.calibration_states import History, add_copy, store_decision
from sunarc.archive.sighting_revisions import ELSEWHERE, MOVED
from sunarc.archive.sightings import not_closed
from sunarc.archive.store import values_of
from sunarc.archive.tables import calibration, pose_epoch, sun_point
from sunarc.archive.validity import end_others, set_columns
from sunarc.archive.values import PoseEpoch
from sunarc.errors import InputError, NotFoundError
from sunarc.findings import Finding

EPOCH_CLOSED = "epoch_closed"
"""Kind of the event of a pose epoch that was closed as wrong."""


class EpochClosing(History):
    """The part of the archive that closes pose epochs opened by mistake."""

    def close_epoch(self, epoch_id: str, *, at: datetime, reason: str) -> str | None:
        """Undo a pose epoch: the one before it continues, and the calibration served before is current again.

        The epoch's row stays, with a duration of 0. Its sightings move to the epoch before; those that were accepted
        only because of the supposed move are rejected again. Its calibrations stop answering at `at`.

        Parameters
        ----------
        epoch_id : any pose epoch but the camera's first.
        at : now; no answer given for an earlier time changes.
        reason : why, in words; kept in the event.

        Returns
        -------
        The id of the calibration that is current afterwards; None where none was served before.

        Raises
        ------
        NotFoundError : there is no such pose epoch, or it is closed already.
        InputError : it is the camera's first.
        """
        with self._writing() as connection:
            wrong, before = _with_the_one_before(connection, epoch_id)
            _join(connection, wrong, before)
            current = self._serve_again(connection, wrong, at=at, reason=reason)
            data = {"pose_epoch": wrong.id, "started_at": wrong.started_at.isoformat(), "reason": reason}
            details = {"continues": before.id, "calibration": current}
            store_decision(connection, Finding(EPOCH_CLOSED, data), at=at, camera=wrong.camera, details=details)
        return current

    def _serve_again(self, connection: Connection, wrong: PoseEpoch, *, at: datetime, reason: str) -> str | None:
        """Make the calibration that was served before an epoch current again, and return the id of the current one."""
        c = calibration.c
        current = self._records(connection, c.camera == wrong.camera, c.state == "current")
        if current and current[0].pose_epoch != wrong.id:
            return current[0].id
        answered = self._records(connection, *self._may_stand_in(connection, wrong.camera, until=at))
        undamaged = [record for record in answered if not record.damaged]
        end_others(connection, wrong.camera, at)
        if not undamaged:
            return None
        last = max(undamaged, key=lambda record: (record.valid_from, record.created_at))
        if last.valid_until is None or last.valid_until > at:  # it still answers: nothing else ever did
            set_columns(connection, last.id, state="current", valid_until=None)
            return last.id
        again = Finding("served_again", {"reason": reason})
        return add_copy(connection, last, at=at, findings=(again, *last.findings)).id


def _with_the_one_before(connection: Connection, epoch_id: str) -> tuple[PoseEpoch, PoseEpoch]:
    epochs = pose_epoch.c
    in_order = values_of(connection, select(pose_epoch).where(not_closed()).order_by(epochs.started_at), PoseEpoch)
    camera = next((epoch.camera for epoch in in_order if epoch.id == epoch_id), None)
    if camera is None:
        raise NotFoundError(
            field="id", problem=f"there is no open pose epoch {epoch_id}", remedy="see `sunarc epochs list`"
        )
    for before, wrong in pairwise(epoch for epoch in in_order if epoch.camera == camera):
        if wrong.id == epoch_id:
            return wrong, before
    raise InputError(
        field="id", problem=f"{epoch_id} is the camera's first pose epoch", remedy="name one that followed another"
    )


def _join(connection: Connection, wrong: PoseEpoch, before: PoseEpoch) -> None:
    """End an epoch where it began, and extend the one before it over its time and its sightings."""
    epochs, c = pose_epoch.c, sun_point.c
    # The row stays, of no duration: its id is never given again, and the event can still name it.
    connection.execute(update(pose_epoch).where(epochs.id == wrong.id).values(ended_at=wrong.started_at))
    connection.execute(update(pose_epoch).where(epochs.id == before.id).values(ended_at=wrong.ended_at))
    admitted = update(sun_point).where(c.pose_epoch == wrong.id, c.reason == MOVED, c.accepted.is_(True))
    connection.execute(admitted.values(accepted=False, verdict=ELSEWHERE, reason="not where it should be"))
    connection.execute(update(sun_point).where(c.pose_epoch == wrong.id).values(pose_epoch=before.id))
