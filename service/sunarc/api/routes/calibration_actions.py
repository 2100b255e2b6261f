"""Routes: what a person decides about calibrations and pose epochs. It changes something, so it needs the token."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Request

from sunarc.api.context import ApiContext
from sunarc.api.middleware.authentication import require_write_token
from sunarc.api.problems import answers
from sunarc.api.routes.calibrations import summary
from sunarc.api.schemas.parameters import CalibrationId
from sunarc.api.schemas.record import CalibrationSummary, ClosedEpoch, Decision
from sunarc.archive.values import CalibrationRecord
from sunarc.errors import NotFoundError

EpochId = Annotated[
    str, Path(description="Id of a pose epoch, as events and calibrations name it.", examples=["imager-2"])
]


def decision_routes(context: ApiContext) -> APIRouter:
    """Return the routes that let a person decide which calibration answers."""
    routes = APIRouter(
        dependencies=[Depends(require_write_token(context.token))], responses=answers(400, 403, 404, 408, 413, 415, 422)
    )
    of_calibrations: dict[str, Any] = {"tags": ["calibrations"], "responses": answers(409)}

    def decide(
        change: Callable[..., CalibrationRecord], request: Request, calibration_id: str, decision: Decision
    ) -> CalibrationSummary:
        record = context.of(request).calibration(calibration_id)
        return summary(change(record.id, at=context.frame_clock(), reason=decision.reason))

    @routes.post("/calibrations/{calibration_id}/activate", **of_calibrations)
    def activate(request: Request, calibration_id: CalibrationId, decision: Decision) -> CalibrationSummary:
        """Make any calibration of the record the current one, from now on; of one that answered before, a copy."""
        return decide(context.archive.reinstate, request, calibration_id, decision)

    @routes.post("/calibrations/{calibration_id}/pin", **of_calibrations)
    def pin(request: Request, calibration_id: CalibrationId, decision: Decision) -> CalibrationSummary:
        """Keep the current calibration, whatever a refit finds, until it is unpinned or another is activated."""
        return decide(context.archive.pin, request, calibration_id, decision)

    @routes.post("/calibrations/{calibration_id}/unpin", **of_calibrations)
    def unpin(request: Request, calibration_id: CalibrationId, decision: Decision) -> CalibrationSummary:
        """Let refits replace the current calibration again."""
        return decide(context.archive.unpin, request, calibration_id, decision)

    @routes.post("/epochs/{epoch_id}/close", tags=["epochs"])
    def close_epoch(request: Request, epoch_id: EpochId, decision: Decision) -> ClosedEpoch:
        """Undo a pose epoch begun by mistake: the one before continues, and its calibration is current again."""
        selected = context.of(request)
        if epoch_id not in {epoch.id for epoch in selected.archive.epochs(selected.camera)}:
            raise NotFoundError(
                field="id",
                problem=f"there is no open pose epoch {epoch_id} of camera {selected.camera}",
                remedy="see `sunarc epochs list`",
            )
        current = selected.archive.close_epoch(epoch_id, at=selected.frame_clock(), reason=decision.reason)
        return ClosedEpoch(id=epoch_id, calibration=current)

    return routes
