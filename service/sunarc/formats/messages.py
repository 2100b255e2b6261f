"""The messages of formats that are asked for or found in a file."""

from __future__ import annotations

from sunarc.common.findings import Message, Messages

_NOTHING_READ = "The file is not read."

MESSAGES = Messages(
    format_unknown=Message("{format!r} is unknown", "Nothing is written.", "use one of {known}"),
    format_without_reader=Message("nothing reads the format {format}", _NOTHING_READ, "give another format"),
    file_format_unknown=Message("of no format that is read", _NOTHING_READ, "give one of {known}"),
)
