"""Routes: the cameras that the archive knows."""

from __future__ import annotations

from dataclasses import asdict

from fastapi import APIRouter

from sunarc.api.context import ApiContext
from sunarc.api.schemas.record import CameraRecordOut, Cameras


def camera_routes(served: ApiContext) -> APIRouter:
    """Return the routes that tell which cameras there are."""
    routes = APIRouter(tags=["cameras"])

    @routes.get("/v1/cameras")
    def cameras() -> Cameras:
        """Tell the cameras of the archive; every route of one camera also stands under /v1/cameras/{camera}/."""
        known = served.archive.cameras()
        return Cameras(
            default=served.camera, cameras=[CameraRecordOut.model_validate(asdict(camera)) for camera in known]
        )

    return routes
