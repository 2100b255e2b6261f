"""Routes: what a person decides about calibrations. It changes something, so it needs the token."""

from __future__ import annotations

from fastapi import APIRouter, Depends, Request

from sunarc.api.context import ApiContext
from sunarc.api.middleware.authentication import require_write_token
from sunarc.api.problems import answers
from sunarc.api.routes.calibrations import summary
from sunarc.api.schemas.parameters import CalibrationId
from sunarc.api.schemas.record import CalibrationSummary, Decision

_REFUSALS = answers(400, 403, 404, 408, 409, 413, 415, 422)


def decision_routes(served: ApiContext) -> APIRouter:
    """Return the routes that let a person decide which calibration answers."""
    routes = APIRouter(
        prefix="/calibrations/{calibration_id}",
        tags=["calibrations"],
        dependencies=[Depends(require_write_token(served.token))],
        responses=_REFUSALS,
    )

    @routes.post("/activate")
    def activate(request: Request, calibration_id: CalibrationId, decision: Decision) -> CalibrationSummary:
        """Make any calibration of the record the current one, from now on; of one that answered before, a copy."""
        chosen = served.of(request)
        record = chosen.calibration(calibration_id)
        return summary(chosen.archive.reinstate(record.id, at=chosen.frame_clock(), reason=decision.reason))

    @routes.post("/pin")
    def pin(request: Request, calibration_id: CalibrationId, decision: Decision) -> CalibrationSummary:
        """Keep the current calibration, whatever a refit finds, until it is unpinned or another is activated."""
        chosen = served.of(request)
        record = chosen.calibration(calibration_id)
        return summary(chosen.archive.pin(record.id, at=chosen.frame_clock(), reason=decision.reason))

    @routes.post("/unpin")
    def unpin(request: Request, calibration_id: CalibrationId, decision: Decision) -> CalibrationSummary:
        """Let refits replace the current calibration again."""
        chosen = served.of(request)
        record = chosen.calibration(calibration_id)
        return summary(chosen.archive.unpin(record.id, at=chosen.frame_clock(), reason=decision.reason))

    return routes
