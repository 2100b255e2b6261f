"""Routes: the calibration that answers, the history, decisions of a person about it, and refits."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Depends, Path, Query, Request
from fastapi.responses import Response

from sunarc.common.errors import InputError, NotFoundError
from sunarc.formats.asi_core import leave_out_obstructions
from sunarc.formats.calibration_document import camera_document
from sunarc.formats.exported import Exported
from sunarc.formats.formats import FORMATS, SERVED, ServedFormat, export
from sunarc.imager.archive.values import CalibrationRecord, CalibrationState, Refit, field_values
from sunarc.imager.web.context import ApiContext, SingleFlightCache
from sunarc.imager.web.hidden_sky import hidden_by_obstructions, obstructions_key
from sunarc.imager.web.middleware.admission import require_write_token
from sunarc.imager.web.parameters import BY_CALIBRATION, At, CalibrationId, Cursor, IfNoneMatch, page_at, row_limit
from sunarc.imager.web.problems import answers, described_answer
from sunarc.imager.web.schemas import Calibrations, CalibrationSummary, ClosedEpoch, Decision, RefitRequest, Refits

_JSON = {"application/json": {"schema": {"type": "object", "additionalProperties": True}}}
_TAGGED = {"ETag": "Changes with the document."}
_SAME = "The document is the one"
_DOCUMENT = described_answer(
    "The calibration document, schema sunarc.calibration/2.", _JSON, headers=_TAGGED, same=_SAME
)
_DETAIL = "Of the JSON document: all of it, or the camera alone, which projects without a sigma of its own (4 kB)."
_EXPORTED = described_answer(
    "The calibration document, schema sunarc.calibration/2, or another format of it.",
    _JSON | {str(FORMATS[name].media_type).partition(";")[0]: {} for name in SERVED if name != "json"},
    headers=_TAGGED,
    numbers={
        "Sunarc-Fit-Error": "How far another format is from the calibration over the sky, RMS, px.",
        "Sunarc-Fit-Error-Max": "The same at most, px.",
        "Sunarc-Fit-Error-Deg": "The same, RMS, degrees.",
    },
    same=_SAME,
)


def calibration_routes(context: ApiContext) -> APIRouter:
    """Return the routes of calibrations."""
    routes = APIRouter(tags=["calibrations"])

    made = {name: SingleFlightCache(partial(_make_export, name), key=document_tag) for name in SERVED}
    written = {"whole": _LastDocument(_text), "camera": _LastDocument(_camera_text)}

    @routes.get("/calibration", dependencies=BY_CALIBRATION, responses=_EXPORTED | answers(404, 422))
    def calibration(
        request: Request,
        at: At = None,
        format_: Annotated[ServedFormat, Query(alias="format", description="Of the answer (docs/rest.md).")] = "json",
        detail: Annotated[Literal["whole", "camera"], Query(description=_DETAIL)] = "whole",
        if_none_match: IfNoneMatch = None,
    ) -> Response:
        """Return the calibration that is valid now, or at the time `at`."""
        record = context.of(request).record(at)
        if format_ == "json":
            return written[detail].answer(record, if_none_match)
        if detail != "whole":
            raise InputError(field="detail", problem=f"is not given of {format_}", remedy="leave out format, or detail")
        return _answer_export(context.of(request), record, made[format_], format_, if_none_match)

    @routes.get("/calibrations", responses=answers(422))
    def calibrations(
        *,
        request: Request,
        state: Annotated[CalibrationState | None, Query(description="Of the calibrations to return.")] = None,
        provisional: Annotated[
            bool, Query(description="Also poses that were estimated before a fit and have been replaced.")
        ] = False,
        limit: Annotated[int, row_limit(1000)] = 100,
        cursor: Cursor = None,
    ) -> Calibrations:
        """Return the history, the newest first, refused candidates with their reasons."""
        selected, page = context.of(request), page_at(cursor, limit)
        found = selected.archive.calibrations.find(
            selected.camera, state=state, until=page.until(None), provisional=provisional, limit=page.rows
        )
        rows, next_ = page.cut(found, request, time=lambda record: record.created_at)
        return Calibrations(calibrations=[summary(record) for record in rows], next=next_)

    @routes.get("/calibrations/{calibration_id}", responses=_DOCUMENT | answers(404))
    def calibration_by_id(
        request: Request, calibration_id: CalibrationId, if_none_match: IfNoneMatch = None
    ) -> Response:
        """Return one calibration's document, with its evidence."""
        return tagged(_text(context.of(request).calibration(calibration_id)), if_none_match)

    return routes


def summary(record: CalibrationRecord) -> CalibrationSummary:
    """Return the entry of a calibration in a list."""
    metrics, uncertainty = record.document.get("metrics", {}), record.document.get("uncertainty", {})
    return CalibrationSummary(
        **field_values(record),
        reasons=list(record.reasons),
        rmse_px=metrics.get("rmse_px"),
        sky_rms_deg=uncertainty.get("sky_rms_deg"),
    )


def document_tag(record: CalibrationRecord) -> str:
    """Return a tag that changes with a calibration's document."""
    return hashlib.sha256(_text(record)).hexdigest()[:32]


class _LastDocument:
    """Cache of the document that was sent last, as text: every client asks for the same one.

    Parameters
    ----------
    text : returns a record's document as text.
    """

    def __init__(self, text: Callable[[CalibrationRecord], bytes]) -> None:
        self._text = text
        self._last: tuple[CalibrationRecord, bytes, str] | None = None

    def answer(self, record: CalibrationRecord, if_none_match: str | None) -> Response:
        """Return the answer with a record's document, encoded anew where another record was sent before."""
        last = self._last
        if last is None or last[0] is not record:
            text = self._text(record)
            last = self._last = record, text, make_etag(text)
        return _tagged_response(last[1], last[2], if_none_match)


def tagged(content: bytes, if_none_match: str | None) -> Response:
    """Return JSON with an ETag of its content; 304 to a client that has it."""
    return _tagged_response(content, make_etag(content), if_none_match)


def make_etag(content: bytes) -> str:
    """Return the ETag of this content, or of the values that decide it."""
    return f'"{hashlib.sha256(content).hexdigest()[:32]}"'


def decimal(value: float, *, digits: int = 4) -> str:
    """Return a number for a header, of so many significant digits, never with an exponent.

    As the decimals of structured fields (RFC 9651), but with more digits after the point where it needs them.
    """
    return np.format_float_positional(value, precision=digits, unique=False, fractional=False, trim="-")


def _tagged_response(content: bytes, tag: str, if_none_match: str | None) -> Response:
    headers = {"etag": tag, "cache-control": "no-cache"}
    if matches(if_none_match, tag):
        return Response(status_code=304, headers=headers)
    return Response(content, media_type="application/json", headers=headers)


def _text(record: CalibrationRecord) -> bytes:
    return _encode_json(record.document)


def _camera_text(record: CalibrationRecord) -> bytes:
    return _encode_json(camera_document(record.document))


def _encode_json(document: Mapping[str, Any]) -> bytes:
    return json.dumps(document, allow_nan=False, separators=(",", ":")).encode()


def _make_export(format_: ServedFormat, record: CalibrationRecord) -> Exported:
    return export(record.document, format_)


def _answer_export(
    context: ApiContext,
    record: CalibrationRecord,
    made: SingleFlightCache[CalibrationRecord, Exported],
    format_: ServedFormat,
    if_none_match: str | None,
) -> Response:
    masked = obstructions_key(context, record) if format_ == "asi-core" else ""
    tag = f'"{document_tag(record)}-{format_}{hashlib.sha256(masked.encode()).hexdigest()[:8] if masked else ""}"'
    headers = {"etag": tag, "cache-control": "no-cache"}
    if matches(if_none_match, tag):
        return Response(status_code=304, headers=headers)
    exported = made.get(record)
    hidden = hidden_by_obstructions(context, record) if masked else None
    if hidden is not None:
        exported = leave_out_obstructions(exported, hidden)
    headers["content-disposition"] = f'attachment; filename="{FORMATS[format_].file}"'
    if exported.difference is not None:
        headers |= {
            "sunarc-fit-error": decimal(exported.difference.rms_px),
            "sunarc-fit-error-max": decimal(exported.difference.max_px),
            "sunarc-fit-error-deg": decimal(exported.difference.rms_deg),
        }
    return Response(exported.sent, media_type=FORMATS[format_].media_type, headers=headers)


def matches(if_none_match: str | None, tag: str) -> bool:
    """Return whether a client that sent this If-None-Match has the content that the tag names."""
    tags = {one.strip().removeprefix("W/") for one in (if_none_match or "").split(",")}
    return tag in tags or "*" in tags


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
        """Make a calibration of the history the current one, from now on; a copy of it where it was current before."""
        return decide(context.archive.calibrations.reinstate, request, calibration_id, decision)

    @routes.post("/calibrations/{calibration_id}/pin", **of_calibrations)
    def pin(request: Request, calibration_id: CalibrationId, decision: Decision) -> CalibrationSummary:
        """Keep the current calibration, whatever a refit finds, until it is unpinned or another is activated."""
        return decide(context.archive.calibrations.pin, request, calibration_id, decision)

    @routes.post("/calibrations/{calibration_id}/unpin", **of_calibrations)
    def unpin(request: Request, calibration_id: CalibrationId, decision: Decision) -> CalibrationSummary:
        """Let refits replace the current calibration again."""
        return decide(context.archive.calibrations.unpin, request, calibration_id, decision)

    @routes.post("/epochs/{epoch_id}/close", tags=["epochs"])
    def close_epoch(request: Request, epoch_id: EpochId, decision: Decision) -> ClosedEpoch:
        """Undo a pose epoch begun by mistake: the one before continues, and its calibration is current again."""
        selected = context.of(request)
        if epoch_id not in {epoch.id for epoch in selected.archive.epochs.find(selected.camera)}:
            raise NotFoundError(
                field="id",
                problem=f"there is no open pose epoch {epoch_id} of camera {selected.camera}",
                remedy="see `sunarc epochs list`",
            )
        current = selected.archive.calibrations.close_epoch(epoch_id, at=selected.frame_clock(), reason=decision.reason)
        return ClosedEpoch(id=epoch_id, calibration=current)

    return routes


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
        found = selected.archive.refits.find(selected.camera, until=page.until(None), limit=page.rows)
        rows, next_ = page.cut(found, request, time=lambda refit: refit.requested_at)
        return Refits(refits=list(rows), next=next_)

    @routes.get("/refits/{refit_id}", responses=answers(404))
    def refit(request: Request, refit_id: RefitId) -> Refit:
        """Return the state of a refit."""
        refit = context.archive.refits.get(refit_id)
        if refit.camera != context.of(request).camera:
            raise NotFoundError(field="id", problem=f"refit {refit_id} is another camera's", remedy="see /v1/cameras")
        return refit

    return routes
