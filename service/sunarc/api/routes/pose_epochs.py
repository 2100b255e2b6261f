"""Routes: what a person decides about pose epochs. It changes something, so it needs the token."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Path, Request

from sunarc.api.context import ApiContext
from sunarc.api.middleware.authentication import require_write_token
from sunarc.api.problems import answers
from sunarc.api.schemas.record import ClosedEpoch, Decision
from sunarc.errors import NotFoundError

_REFUSALS = answers(400, 403, 404, 408, 413, 415, 422)

EpochId = Annotated[
    str, Path(description="Id of a pose epoch, as events and calibrations name it.", examples=["imager-2"])
]


def epoch_routes(served: ApiContext) -> APIRouter:
    """Return the route that undoes a pose epoch."""
    routes = APIRouter(
        prefix="/epochs/{epoch_id}",
        tags=["epochs"],
        dependencies=[Depends(require_write_token(served.token))],
        responses=_REFUSALS,
    )

    @routes.post("/close")
    def close(request: Request, epoch_id: EpochId, decision: Decision) -> ClosedEpoch:
        """Undo a pose epoch begun by mistake: the one before continues, and its calibration is current again."""
        chosen = served.of(request)
        if epoch_id not in {epoch.id for epoch in chosen.archive.epochs(chosen.camera)}:
            raise NotFoundError(
                field="id",
                problem=f"there is no open pose epoch {epoch_id} of camera {chosen.camera}",
                remedy="see `sunarc epochs list`",
            )
        current = chosen.archive.close_epoch(epoch_id, at=chosen.frame_clock(), reason=decision.reason)
        return ClosedEpoch(id=epoch_id, calibration=current)

    return routes
