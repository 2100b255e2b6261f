"""Results of earlier runs: an answer for each image and pass, so that a run goes on where it was.

A database of its own, in the output folder or at an address of SQLAlchemy: it is a cache of what workers answered.
Other code of this software reads the images again, so that nothing has to be migrated. Results that rest on many
images (states, fits, exports) are kept by a hash of what they were made of.
"""

from __future__ import annotations

import hashlib
import io
import json
import pickle
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from datetime import date, timedelta
from importlib import import_module
from types import TracebackType
from typing import Any, NamedTuple, Protocol, Self, TypeVar, cast

import numpy as np
import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

from sunarc.common.errors import OutsideError
from sunarc.common.findings import Finding, from_json
from sunarc.detection.values import Detection
from sunarc.sources.look import NamedStars, PackedMask, software

_METADATA = sa.MetaData()
_ANSWER = sa.Table(
    "image_answer",
    _METADATA,
    sa.Column("camera", sa.String(200), primary_key=True),
    sa.Column("address", sa.String(500), primary_key=True),
    sa.Column("file", sa.String(500), primary_key=True),
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("stage", sa.Integer, primary_key=True),
    sa.Column("key", sa.String(24), nullable=False),
    sa.Column("stamp", sa.String(24), nullable=False),
    sa.Column("content", sa.String(32)),
    sa.Column("found", sa.Text, nullable=False),
)
_CHUNK = sa.Table(
    "chunk",
    _METADATA,
    sa.Column("id", sa.Integer, primary_key=True),
    sa.Column("camera", sa.String(200), nullable=False),
    sa.Column("stage", sa.Integer, nullable=False),
    sa.Column("images", sa.Integer, nullable=False),
    sa.Column("version", sa.String(40), nullable=False),
)
_MASK = sa.Table(
    "mask",
    _METADATA,
    sa.Column("camera", sa.String(200), primary_key=True),
    sa.Column("version", sa.String(40), nullable=False),
    sa.Column("rows", sa.Integer),
    sa.Column("columns", sa.Integer),
    sa.Column("compressed", sa.LargeBinary),
)
_RESULT = sa.Table(
    "result",
    _METADATA,
    sa.Column("name", sa.String(24), primary_key=True),
    sa.Column("key", sa.String(24), nullable=False),
    sa.Column("content", sa.LargeBinary, nullable=False),
)
_AT_ONCE = 1000
"""Rows that are held at once while a camera's answers are read."""
_FIELDS = [name for name in Detection.__slots__ if name != "findings"]


ANY = ""
"""Key, or stamp, of an answer that holds whatever it rests on."""


class ImageId(NamedTuple):
    """Which image: the source's address, the file, the number of the frame."""

    address: str
    file: str
    number: int


class Known(NamedTuple):
    """An answer of a former run.

    Attributes
    ----------
    key : of the values that decided it with the file: version, method, mask, prediction.
    found : what it was.
    stamp : of the file's size and time when it was last read, or of its checksum in an archive.
    content : hash of the file's bytes; None where the file was not read as a whole.
    """

    key: str
    found: Detection | NamedStars | Finding
    stamp: str = ANY
    content: str | None = None


class KeptMask(NamedTuple):
    """Static parts of a camera's images, as they were seen once; None without any."""

    mask: PackedMask | None


Given = TypeVar("Given")
Made = TypeVar("Made")


class ParallelMap(Protocol):
    """Has a function called with each of some values, somewhere; None for those that it could not be done with."""

    def __call__(self, run: Callable[[Given], Made], given: Sequence[Given], /) -> list[Made | None]:
        """Return the results."""


class Ledger:
    """The database of answers.

    Parameters
    ----------
    address : of SQLAlchemy: `sqlite:///…` or `postgresql+psycopg://…`.

    Raises
    ------
    OutsideError : it cannot be opened.
    """

    def __init__(self, address: str) -> None:
        self._engine: sa.Engine = sa.create_engine(address)
        with self._connect() as connection:
            if self._engine.dialect.name == "sqlite":
                connection.exec_driver_sql("PRAGMA journal_mode=WAL")
        with self._connect() as connection:
            _METADATA.create_all(connection)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        self._engine.dispose()

    @contextmanager
    def _connect(self) -> Iterator[sa.Connection]:
        """Connect, for one transaction; raise OutsideError where the database cannot be used, as a damaged one."""
        try:
            with self._engine.begin() as connection:
                yield connection
        except (SQLAlchemyError, UnicodeDecodeError) as error:
            why = str(error).partition("\n")[0]
            raise OutsideError(f"{self._engine.url} cannot be used: {why}; a new one is filled again") from error

    def answers(self, camera: str, *, pass_number: int) -> Iterator[tuple[ImageId, Known]]:
        """Yield the answers for a camera's images in a pass; one that is damaged is left out, and made again."""
        c = _ANSWER.c
        columns = (c.address, c.file, c.number, c.key, c.stamp, c.content, c.found)
        rows = sa.select(*columns).where(c.camera == camera, c.stage == pass_number)
        with self._connect() as connection:
            for row in connection.execution_options(yield_per=_AT_ONCE).execute(rows):
                try:
                    known = Known(row.key, _answer_from_json(json.loads(row.found)), row.stamp, row.content)
                except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
                    continue
                yield ImageId(row.address, row.file, row.number), known

    def store(self, camera: str, pass_number: int, answers: Iterable[tuple[ImageId, Known]], *, version: str) -> None:
        """Store the answers of a finished chunk, in one transaction, in place of former ones."""
        rows = [
            {
                **image._asdict(),
                **known._asdict(),
                "camera": camera,
                "stage": pass_number,
                "found": json.dumps(_answer_to_json(known.found)),
            }
            for image, known in answers
        ]
        c = _ANSWER.c
        with self._connect() as connection:
            for row in rows:
                same = (c.camera == camera, c.address == row["address"], c.file == row["file"])
                connection.execute(sa.delete(_ANSWER).where(*same, c.number == row["number"], c.stage == pass_number))
            if rows:
                connection.execute(sa.insert(_ANSWER), rows)
            count = {"camera": camera, "stage": pass_number, "images": len(rows), "version": version}
            connection.execute(sa.insert(_CHUNK), [count])

    def mask(self, camera: str, *, version: str) -> KeptMask | None:
        """Return the mask of a camera that was kept; None where none was, or by another version, or it is damaged."""
        c = _MASK.c
        rows = sa.select(c.rows, c.columns, c.compressed).where(c.camera == camera, c.version == version)
        with self._connect() as connection:
            row = connection.execute(rows).first()
        if row is None:
            return None
        if row.compressed is None:
            return KeptMask(None)
        try:
            packed = PackedMask((row.rows, row.columns), bytes(row.compressed))
            packed.unpacked()
        except (ValueError, TypeError, zlib.error):
            return None
        return KeptMask(packed)

    def keep_mask(self, camera: str, mask: PackedMask | None, *, version: str) -> None:
        """Keep the mask of a camera."""
        rows, columns = (None, None) if mask is None else mask.shape
        compressed = None if mask is None else mask.compressed
        row = {"camera": camera, "version": version, "rows": rows, "columns": columns, "compressed": compressed}
        with self._connect() as connection:
            connection.execute(sa.delete(_MASK).where(_MASK.c.camera == camera))
            connection.execute(sa.insert(_MASK), [row])

    def result(self, name: str, key: str) -> Any:  # noqa: ANN401 - of any type
        """Return the result kept under a name; None without one, or where it was made of something else."""
        rows = sa.select(_RESULT.c.content).where(_RESULT.c.name == content_key(name), _RESULT.c.key == key)
        with self._connect() as connection:
            content = connection.scalar(rows)
        return None if content is None else _unpack_result(content)

    def keep_result(self, name: str, key: str, value: object) -> None:
        """Keep a result under a name in place of the former one, with the hash of the values it was made of."""
        # by its hash: a name holds paths, which may be longer than a column
        row = {"name": content_key(name), "key": key, "content": pickle.dumps(value, protocol=5)}
        with self._connect() as connection:
            connection.execute(sa.delete(_RESULT).where(_RESULT.c.name == row["name"]))
            connection.execute(sa.insert(_RESULT), [row])

    def each(
        self, make: ParallelMap, run: Callable[[Given], Made], given: Sequence[Given], *, names: Sequence[str]
    ) -> list[Made | None]:
        """Return the result of a function for each of some values; a result of the same values is not made again.

        Parameters
        ----------
        make : has the function called where there is no result.
        run, given : the function, and the values.
        names : of the values: a result takes the place of the former one of its name.
        """
        function = getattr(run, "__name__", "")
        keys = [content_key((software(), function, one)) for one in given]
        found = [self.result(f"{function} {name}", key) for name, key in zip(names, keys, strict=True)]
        missing = [number for number, one in enumerate(found) if one is None]
        for number, made in zip(missing, make(run, [given[n] for n in missing]) if missing else [], strict=True):
            found[number] = made
            if made is not None:
                self.keep_result(f"{function} {names[number]}", keys[number], made)
        return cast("list[Made | None]", found)

    def count_finished_chunks(self) -> int:
        """Return how many chunks were ever finished."""
        with self._connect() as connection:
            return int(connection.scalar(sa.select(sa.func.count()).select_from(_CHUNK)) or 0)


def _answer_to_json(found: Detection | NamedStars | Finding) -> dict[str, Any]:
    if isinstance(found, Finding):
        return {"refused": found.as_json()}
    if isinstance(found, NamedStars):
        return {"stars": found.rows}
    fields = {name: _plain_value(getattr(found, name)) for name in _FIELDS}
    return {**fields, "findings": [finding.as_json() for finding in found.findings]}


def _answer_from_json(stored: Mapping[str, Any]) -> Detection | NamedStars | Finding:
    if "refused" in stored:
        return from_json(stored["refused"])
    if "stars" in stored:
        return NamedStars(tuple((name, x, y, sigma) for name, x, y, sigma in stored["stars"]))
    fields = {name: stored[name] for name in _FIELDS}
    return Detection(**fields, findings=tuple(from_json(one) for one in stored["findings"]))


def _plain_value(value: Any) -> Any:  # noqa: ANN401 - a field of any type
    """Return a value as JSON has it: numpy's numbers are Python's."""
    return value.item() if hasattr(value, "item") else value


def content_key(value: object) -> str:
    """Return a hash of a value's content, the same in every process: of numbers, texts, arrays, and records of them.

    Raises
    ------
    TypeError : a value of another type is in it.
    """
    hashed = hashlib.blake2b(digest_size=12)
    for part in _hash_parts(value):
        hashed.update(len(part).to_bytes(8, "little") + part)
    return hashed.hexdigest()


def _hash_parts(value: Any) -> Iterator[bytes]:  # noqa: ANN401 - of any type
    if isinstance(value, np.ndarray):
        yield f"array {value.dtype.str} {value.shape}".encode()
        yield value.tobytes()
    elif is_dataclass(value):
        yield type(value).__name__.encode()
        for one in fields(value):
            yield from _hash_parts(getattr(value, one.name))
    elif isinstance(value, Mapping):
        yield f"mapping {len(value)}".encode()
        for key, one in sorted(value.items(), key=lambda item: repr(item[0])):
            yield repr(key).encode()
            yield from _hash_parts(one)
    elif isinstance(value, tuple | list):
        yield f"{type(value).__name__} {len(value)}".encode()
        for one in value:
            yield from _hash_parts(one)
    elif value is None or isinstance(value, str | bytes | int | float | date | timedelta | np.generic):
        yield repr(value.item() if isinstance(value, np.generic) else value).encode()
    else:
        raise TypeError(f"{type(value).__name__} has no hash of its content")


_NUMPY = {"_reconstruct", "_frombuffer", "ndarray", "dtype", "scalar"}


class _RestrictedUnpickler(pickle.Unpickler):
    """Reads values of numpy and of this package: a ledger that others wrote runs nothing of theirs."""

    def find_class(self, module: str, name: str) -> Any:  # noqa: ANN401 - a class
        found = getattr(import_module(module), name) if module.partition(".")[0] in {"numpy", "sunarc"} else None
        if module.startswith("numpy.") or module == "numpy":
            if name in _NUMPY:
                return found
        elif isinstance(found, type) and (is_dataclass(found) or hasattr(found, "_fields")):
            return found
        raise pickle.UnpicklingError(f"{module}.{name} is no value")


def _unpack_result(content: Any) -> Any:  # noqa: ANN401 - of any type
    """Return a kept value; None where it is damaged or this software has no such values: it is made again."""
    try:
        return _RestrictedUnpickler(io.BytesIO(content)).load()
    except Exception:  # noqa: BLE001 - a damaged pickle raises errors of any kind
        return None
