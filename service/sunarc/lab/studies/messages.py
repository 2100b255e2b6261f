"""Findings of the benchmark about an entry."""

from __future__ import annotations

from sunarc.common.findings import Message, Messages

_SCORED = "The rows are scored as they are."
MESSAGES = Messages(
    benchmark_case_missing=Message(
        "case {case}: neither an answer nor a refusal", "The case counts as lost.", "answer it, or refuse it"
    ),
    benchmark_case_unknown=Message("{case}: not a case of this round", "The file is not scored.", "remove it"),
    benchmark_entry_unreadable=Message(
        "case {case}: {problem}", "The case counts as lost.", "write the format of docs/benchmark/README.md"
    ),
    benchmark_rows_missing=Message(
        "case {case}: {n} of {of} pixels are missing", "They cost what having no calibration costs.", "answer all"
    ),
    benchmark_rows_reordered=Message(
        "case {case}: rows in another order than the queries", "They are matched by their pixels."
    ),
    benchmark_rows_repeated=Message(
        "case {case}: {n:pixel} answered more than once", "The first answer counts.", "answer each once"
    ),
    benchmark_rows_undefined=Message(
        "case {case}: {n} of {of} directions are not numbers",
        "They cost what having no calibration costs.",
        "answer all, or refuse the case",
    ),
    benchmark_rows_unknown=Message("case {case}: {n:row} of pixels that are not asked for", "They are left out."),
    benchmark_sigma_undefined=Message(
        "case {case}: {n} of {of} stated errors are negative or no numbers",
        "The truth counts as outside of them.",
        "state all errors, or none",
    ),
    benchmark_sigma_zero=Message(
        "case {case}: {n} of {of} stated errors are zero", "Only an exact answer lies within. " + _SCORED
    ),
    benchmark_truth_differs=Message(
        "the truth is not the one whose hash the round published",
        "The scores are of another truth.",
        "make the round again with its seed and this version",
    ),
)
