"""The page docs/checks.md from the table of checks.

python docs/architecture/checks.py
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from sunarc.calibration.verdict import TABLE, Bound, FitCheck

PAGE = Path(__file__).parents[1] / "checks.md"
_HEAD = """# Checks of a fit

By these checks a fit is refused, kept as a candidate, or used, and with what it states of itself. The order of the
rows is the order of a verdict's findings; where the checks of a stage find nothing, the next stage follows. A limit is
of a number of the finding; where none is given, the row's code in [codes.md](codes.md) says when it is found.
`camera_tilted` has further codes for the mistake that may be behind it. `python docs/architecture/checks.py` writes
this page from `service/sunarc/calibration/verdict.py`.

- refuse: the fit is refused, with all findings of the stage.
- keep: the fit is kept as a candidate that an operator may activate.
- widen: the stated uncertainty is larger for it.
- say: it changes nothing; with refusals it explains them.
"""


def page() -> str:
    """Return the page."""
    parts = [_HEAD]
    for stage, checks in TABLE.items():
        rows = (f"| `{one.code}` | {_limit(one)} | {one.effect} |" for one in checks)
        parts.append("\n".join((f"\n## {stage}\n", "| code | limit | effect |", "|---|---|---|", *rows, "")))
    return "".join(parts)


def _limit(check: FitCheck) -> str:
    limit = check.limit
    if limit is None:
        return ""
    number = f"`{limit.of}` / `{limit.per}`" if limit.per else f"`{limit.of}`"
    return f"{number} {'at least' if limit.least else 'at most'} {_value(limit)}"


def _value(limit: Bound) -> str:
    value = limit.value
    if isinstance(value, str):
        return f"`{value}`"
    return _described(value) if callable(value) else f"{value:g}"


def _described(function: Callable[..., float]) -> str:
    return (function.__doc__ or "").splitlines()[0].removeprefix("Return ").rstrip(".")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
