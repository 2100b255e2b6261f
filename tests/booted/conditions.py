"""The conditions that the service reports of itself, waited for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .machine import wait_for

if TYPE_CHECKING:
    from .conftest import Field


def reasons(field: Field) -> set[str]:
    """Return the codes of the conditions; none while the service does not answer."""
    status = field.ask("/v1/status")
    return set() if status is None else {reason["code"] for reason in status["reasons"]}


def wait_for_reason(field: Field, *codes: str) -> None:
    """Wait until one of the conditions is reported."""
    wait_for(lambda: bool(reasons(field) & set(codes)), within_s=180.0, what=" or ".join(codes), every_s=1.0)


def wait_until_gone(field: Field, *codes: str) -> None:
    """Wait until the service answers and reports none of the conditions."""

    def gone() -> bool:
        return field.ask("/v1/status") is not None and not reasons(field) & set(codes)

    wait_for(gone, within_s=180.0, what=f"the end of {' and '.join(codes)}", every_s=1.0)
