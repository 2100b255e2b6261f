"""Metadata of an image file: a document in JSON, where the readers of PNG and JPEG look for text.

In a PNG it stands in an ``iTXt`` chunk named ``sunarc`` (Pillow: ``picture.text["sunarc"]``; exiftool shows it), with
the standard's ``Software`` and ``Creation Time`` with it; in a JPEG it is the comment (``picture.info["comment"]``).
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from typing import Any

_PNG = b"\x89PNG\r\n\x1a\n"
_AFTER_HEADER = len(_PNG) + 25  # the header chunk comes first and is always as long
_KEYWORD = "sunarc"
_LINEAR = 100_000  # of gAMA: counts are proportional to light
_JPEG = b"\xff\xd8"
_COMMENT = 0xFE
_COMMENT_BYTES = 65_533


def png_with(png: bytes, document: Mapping[str, Any], *, software: str, created: str) -> bytes:
    """Return a PNG of linear counts that carries a document.

    Parameters
    ----------
    png : a whole PNG without these chunks.
    document : what JSON can hold.
    software, created : who made it, and when (RFC 3339).
    """
    chunks = (
        _make_png_chunk(b"gAMA", struct.pack(">I", _LINEAR)),
        _make_png_text("Software", software),
        _make_png_text("Creation Time", created),
        _make_png_text(_KEYWORD, json.dumps(document)),
    )
    return png[:_AFTER_HEADER] + b"".join(chunks) + png[_AFTER_HEADER:]


def jpeg_with(jpeg: bytes, document: Mapping[str, Any]) -> bytes:
    """Return a JPEG that carries a document as its comment; one that is too long is left away."""
    comment = json.dumps(document).encode()
    if len(comment) > _COMMENT_BYTES:
        return jpeg
    start = _find_segment_end(jpeg, len(_JPEG)) if jpeg[3:4] == b"\xe0" else len(_JPEG)
    return jpeg[:start] + struct.pack(">BBH", 0xFF, _COMMENT, len(comment) + 2) + comment + jpeg[start:]


def embedded_document(encoded: bytes) -> dict[str, Any] | None:
    """Return the document that an image file carries; None where it carries none that is whole."""
    try:
        texts = _list_png_texts(encoded) if encoded.startswith(_PNG) else _list_jpeg_comments(encoded)
        for text in texts:
            document = json.loads(text)
            if isinstance(document, dict) and str(document.get("schema", "")).startswith("sunarc."):
                return document
    except (ValueError, struct.error, IndexError, RecursionError):
        return None
    return None


def _make_png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _make_png_text(keyword: str, text: str) -> bytes:
    return _make_png_chunk(b"iTXt", keyword.encode("latin-1") + b"\0\0\0\0\0" + text.encode())


def _list_png_texts(png: bytes) -> Iterator[str]:
    """Yield the texts of our keyword; they stand before the image data."""
    at, prefix = len(_PNG), _KEYWORD.encode() + b"\0\0\0\0\0"
    while at + 8 <= len(png):
        length, kind = struct.unpack_from(">I4s", png, at)
        data = png[at + 8 : at + 8 + length]
        if kind == b"IDAT":
            return
        if kind == b"iTXt" and data.startswith(prefix):
            yield data[len(prefix) :].decode()
        at += 12 + length


def _list_jpeg_comments(jpeg: bytes) -> Iterator[str]:
    """Yield the comments before the image data."""
    at = len(_JPEG)
    while jpeg.startswith(_JPEG) and jpeg[at] == 0xFF and jpeg[at + 1] != 0xDA:
        end = _find_segment_end(jpeg, at)
        if jpeg[at + 1] == _COMMENT:
            yield jpeg[at + 4 : end].decode()
        at = end


def _find_segment_end(jpeg: bytes, at: int) -> int:
    """Return where the segment that begins at `at` ends."""
    (length,) = struct.unpack_from(">H", jpeg, at + 2)
    return int(at + 2 + length)
