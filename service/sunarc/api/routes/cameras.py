"""Routes: the cameras that the archive knows."""

from __future__ import annotations

from fastapi import APIRouter

from sunarc.api.context import ApiContext
from sunarc.api.schemas.record import Cameras


def camera_routes(context: ApiContext) -> APIRouter:
    """Return the routes that tell which cameras there are."""
    routes = APIRouter(tags=["cameras"])

    @routes.get("/v1/cameras")
    def cameras() -> Cameras:
        """Tell the cameras of the archive; every route of one camera also stands under /v1/cameras/{camera}/."""
        return Cameras(default=context.camera, cameras=list(context.archive.cameras()))

    return routes
