"""Routes: ask for a refit, and follow it. Asking changes something, so it needs the token."""

from __future__ import annotations

import hmac
from dataclasses import asdict
from http import HTTPStatus

from fastapi import APIRouter, Depends, Request, Response

from sunarc.api.problems import Fault, RefusedError, answers
from sunarc.api.schemas import RefitOut, RefitRequest
from sunarc.api.served import Served
from sunarc.archive import Refit


def refit_routes(served: Served) -> APIRouter:
    """Return the routes that ask for refits and follow them."""
    routes = APIRouter(tags=["refits"])

    def with_token(request: Request) -> None:
        _require_token(request.headers.get("authorization", ""), served.token)

    @routes.post(
        "/v1/refits", status_code=202, dependencies=[Depends(with_token)], responses=answers(400, 401, 403, 413, 422)
    )
    def ask(response: Response, asked: RefitRequest | None = None) -> RefitOut:
        """Ask for a refit with all sightings; the answer says where to follow it."""
        refit = served.request_refit((asked or RefitRequest()).reason)
        response.headers["location"] = f"/v1/refits/{refit.id}"
        return _out(refit)

    @routes.get("/v1/refits/{refit_id}", responses=answers(404))
    def one(refit_id: str) -> RefitOut:
        """Tell how a refit goes, or went."""
        return _out(served.archive.refit(refit_id))

    return routes


def _out(refit: Refit) -> RefitOut:
    return RefitOut(**asdict(refit))


def _require_token(authorization: str, token: bytes | None) -> None:
    if token is None:
        raise RefusedError(
            HTTPStatus.FORBIDDEN,
            Fault(field="authorization", problem="nothing can be changed here", remedy="set api.token_file"),
        )
    scheme, _, given = authorization.partition(" ")
    if scheme.lower() != "bearer" or not hmac.compare_digest(given.strip().encode("utf-8", "replace"), token):
        raise RefusedError(
            HTTPStatus.UNAUTHORIZED,
            Fault(field="authorization", problem="no token, or a wrong one", remedy="send Authorization: Bearer …"),
            headers={"www-authenticate": "Bearer"},
        )
