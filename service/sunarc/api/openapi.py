"""The OpenAPI document: FastAPI's, with one shape for all problems."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel
from pydantic.json_schema import JsonSchemaMode, models_json_schema

from sunarc.api.problems import Fault, Problem, answers
from sunarc.api.schemas.calibration import BackProjectRequest, ProjectRequest
from sunarc.api.schemas.geolocation import GeolocateRequest

_DESCRIPTION = """Keeps the geometric calibration of an all-sky imager right, from the sun and the stars.

Pixels are (x, y) in px, x right, y down, (0, 0) the centre of the top-left pixel. Zenith and azimuth are in degrees,
azimuth clockwise from north; directions are apparent (refracted) unit vectors, east-north-up. Times are RFC 3339, UTC.
A sigma is per axis, an RMSE is of the two-dimensional distance. null means that there is no answer.

Every route below /v1 but /v1/status and /v1/cameras answers for this service's own camera; as /v1/cameras/{camera}/…
it answers for any camera that /v1/cameras lists (404 for another name)."""

_OTHERS: tuple[tuple[type[BaseModel], JsonSchemaMode], ...] = (
    (Problem, "serialization"),
    (Fault, "serialization"),
    (BackProjectRequest, "validation"),
    (ProjectRequest, "validation"),
    (GeolocateRequest, "validation"),
)
"""Shapes that no route's signature names."""
_TAGS = {
    "health": "whether the service answers, how it is, and its numbers",
    "cameras": "what the archive knows",
    "calibrations": "the one that answers, the history, and decisions by hand",
    "directions": "pixels to directions and back, clouds and shadows",
    "sun": "where it is, and where it was seen",
    "images": "composites, maps of them, masks and tables for OpenCV",
    "record": "days, events as they were and as they happen, the latest image",
    "refits": "asked for, under way and done",
    "epochs": "intervals in which the camera did not move",
    "fleet": "what a hub holds of its cameras, and takes from them",
    "drawing": "lines and shades to draw over the image",
}
_TEXTS = {"text/plain": "string", "application/yaml": "object"}
"""Type of the content of the media types that are no bytes; YAML is what a reader of it makes of it."""


def describe(app: FastAPI) -> None:
    """Make the application tell its document."""

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _document(app)
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]  # FastAPI's own way to do this


def _document(app: FastAPI) -> dict[str, Any]:
    document = get_openapi(title=app.title, version=app.version, description=_DESCRIPTION, routes=app.routes)
    template = "#/components/schemas/{model}"
    _, others = models_json_schema([*_OTHERS], ref_template=template)
    schemas = document["components"]["schemas"]
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    schemas |= others["$defs"]
    document["paths"] = {path.replace("{camera}", "", 1): one for path, one in document["paths"].items()}
    for path in document["paths"].values():
        for operation in path.values():
            _only_problems(operation["responses"])
            _describe_bytes(operation["responses"])
    used = {tag for path in document["paths"].values() for one in path.values() for tag in one.get("tags", ())}
    document["tags"] = [{"name": name, "description": _TAGS[name]} for name in sorted(used)]
    return document


def _describe_bytes(responses: dict[str, Any]) -> None:
    """Give a schema to every content that has none: files and texts."""
    for answer in responses.values():
        for media_type, content in answer.get("content", {}).items():
            of_text = _TEXTS.get(media_type)
            described = {"type": of_text} if of_text else {"type": "string", "format": "binary"}
            content.setdefault("schema", described)


def _only_problems(responses: dict[str, Any]) -> None:
    """Replace FastAPI's own answer to what is invalid, and add the ones that any route may give."""
    if "HTTPValidationError" in str(responses.get("422", "")):
        responses["422"] = answers(422)[422]
    for status, answer in answers(400, 401, 421, 422, 429, 500, 503).items():
        responses.setdefault(str(status), answer)
