"""The conditions that the service reports of itself, waited for."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .machine import wait_for

if TYPE_CHECKING:
    from .conftest import Field


def findings(field: Field) -> dict[str, dict[str, Any]]:
    """Return the data of the conditions by their codes; none while the service does not answer."""
    status = field.ask("/v1/status") or {"findings": []}
    return {finding["code"]: finding["data"] for finding in status["findings"]}


def wait_for_reason(field: Field, *codes: str) -> None:
    """Wait until one of the conditions is reported."""
    wait_for(lambda: not findings(field).keys().isdisjoint(codes), within_s=180.0, what=" or ".join(codes), every_s=1.0)


def wait_until_gone(field: Field, *codes: str) -> None:
    """Wait until the service answers and reports none of the conditions."""

    def gone() -> bool:
        return field.ask("/v1/status") is not None and findings(field).keys().isdisjoint(codes)

    wait_for(gone, within_s=180.0, what=f"the end of {' and '.join(codes)}", every_s=1.0)
