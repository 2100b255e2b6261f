"""Routes: ask for a refit, and follow it. Asking changes something, so it needs the token."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Path, Request, Response

from sunarc.api.context import ApiContext
from sunarc.api.middleware.admission import require_write_token
from sunarc.api.parameters import Cursor, page_at, row_limit
from sunarc.api.problems import answers
from sunarc.api.schemas import RefitRequest, Refits
from sunarc.archive.values import Refit
from sunarc.errors import NotFoundError

RefitId = Annotated[str, Path(description="Id of a refit, as the answer to its request has it.", examples=["3f2a9c"])]


def refit_routes(context: ApiContext) -> APIRouter:
    """Return the routes that ask for refits and follow them."""
    routes = APIRouter(tags=["refits"])

    @routes.post(
        "/refits",
        status_code=202,
        dependencies=[Depends(require_write_token(context.token))],
        responses=answers(400, 403, 408, 413, 415, 422),
    )
    def request_refit(request: Request, response: Response, asked: RefitRequest | None = None) -> Refit:
        """Request a refit with all sightings; the answer has its address. A refit that waits already is returned."""
        refit = context.of(request).request_refit((asked or RefitRequest()).reason)
        response.headers["location"] = f"/v1/refits/{refit.id}"
        return refit

    @routes.get("/refits", responses=answers(422))
    def refits(request: Request, limit: Annotated[int, row_limit()] = 100, cursor: Cursor = None) -> Refits:
        """Return the refits, waiting, running and completed, the newest first."""
        selected, page = context.of(request), page_at(cursor, limit)
        found = selected.archive.refits(selected.camera, until=page.until(None), limit=page.rows)
        rows, next_ = page.cut(found, request, time=lambda refit: refit.requested_at)
        return Refits(refits=list(rows), next=next_)

    @routes.get("/refits/{refit_id}", responses=answers(404))
    def refit(request: Request, refit_id: RefitId) -> Refit:
        """Return the state of a refit."""
        refit = context.archive.refit(refit_id)
        if refit.camera != context.of(request).camera:
            raise NotFoundError(field="id", problem=f"refit {refit_id} is another camera's", remedy="see /v1/cameras")
        return refit

    return routes
