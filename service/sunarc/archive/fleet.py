"""The hub's cameras: their tokens, their installations, what is in quarantine of them, and how they are."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import delete, func, insert, or_, select, update

from sunarc.archive.feed_values import FleetCamera, Quarantined
from sunarc.archive.rows import upsert
from sunarc.archive.store import Store, given
from sunarc.archive.tables import camera, feed, feed_token, fleet, quarantine
from sunarc.errors import NotFoundError


class FleetRegistry(Store):
    """The part of the archive with the cameras of a fleet."""

    def quarantine(self, camera: str | None = None, *, limit: int | None = None) -> tuple[Quarantined, ...]:
        """Return what was refused or set apart, the newest first."""
        c = quarantine.c
        statement = select(quarantine).where(*given((c.camera.__eq__, camera)))
        return self._values(statement.order_by(c.last_at.desc(), c.camera, c.seq).limit(limit), Quarantined)

    def fleet(self) -> tuple[FleetCamera, ...]:
        """Return every camera that was registered or fed, with how many things of it are in quarantine."""
        apart = select(quarantine.c.camera, func.count().label("n")).group_by(quarantine.c.camera).subquery()
        known = select(feed_token.c.camera).union(select(fleet.c.camera)).subquery()
        f = fleet.c
        columns = [column for column in f if column.name != "camera"]
        site = (camera.c.latitude, camera.c.longitude, camera.c.altitude)
        statement = (
            select(known.c.camera, *columns, *site, func.coalesce(apart.c.n, 0).label("n_quarantined"))
            .select_from(known)
            .outerjoin(fleet, f.camera == known.c.camera)
            .outerjoin(camera, camera.c.name == known.c.camera)
            .outerjoin(apart, apart.c.camera == known.c.camera)
            .order_by(known.c.camera)
        )
        with self._reading() as connection:
            return tuple(FleetCamera(**row) for row in connection.execute(statement).mappings())

    def add_feed_token(self, camera: str, digest: str, *, now: datetime, former_until: datetime) -> None:
        """Register a camera by the digest of its token; tokens that it has end at `former_until`."""
        c = feed_token.c
        former = update(feed_token).where(c.camera == camera, or_(c.expires_at.is_(None), c.expires_at > former_until))
        with self._writing() as connection:
            connection.execute(former.values(expires_at=former_until))
            connection.execute(insert(feed_token).values(digest=digest, camera=camera, created_at=now))
            connection.execute(
                delete(quarantine).where(quarantine.c.camera == camera, quarantine.c.reason == "unknown_camera")
            )

    def end_feed_tokens(self, camera: str, *, now: datetime) -> int:
        """End all tokens of a camera, and return how many there were."""
        c = feed_token.c
        valid = update(feed_token).where(c.camera == camera, or_(c.expires_at.is_(None), c.expires_at > now))
        with self._writing() as connection:
            return connection.execute(valid.values(expires_at=now)).rowcount

    def feed_tokens(self, camera: str, *, now: datetime) -> tuple[str, ...] | None:
        """Return the digests of a camera's valid tokens; None where the camera was never registered."""
        c = feed_token.c
        with self._reading() as connection:
            rows = connection.execute(select(c.digest, c.expires_at).where(c.camera == camera)).all()
        valid = tuple(row.digest for row in rows if row.expires_at is None or row.expires_at > now)
        return valid if rows else None

    def accept_installation(self, camera: str, installation: str, *, now: datetime) -> None:
        """Take what an installation sends from now on, in place of the one that was taken before."""
        c = feed.c
        with self._writing() as connection:
            connection.execute(update(feed).where(c.camera == camera).values(accepted=False))
            row = {"camera": camera, "installation": installation, "committed": 0, "accepted": True}
            upsert(connection, feed, {**row, "first_at": now, "last_at": now}, key=["camera", "installation"])
            q = quarantine.c
            here = (q.camera == camera, q.installation == installation, q.reason == "second_installation")
            connection.execute(delete(quarantine).where(*here))

    def ask_again(self, camera: str) -> None:
        """Have all rows of a camera sent again, and clear what is set apart of it."""
        with self._writing() as connection:
            done = connection.execute(update(feed).where(feed.c.camera == camera).values(committed=-1))
            connection.execute(delete(quarantine).where(quarantine.c.camera == camera))
        if not done.rowcount:
            raise NotFoundError(field="camera", problem=f"camera {camera} sent nothing yet", remedy="see /v1/fleet")
