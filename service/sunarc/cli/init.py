"""The command `sunarc init`: asks for the site and the source, tries the rest, writes the settings file."""

from __future__ import annotations

import os
import stat
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from rich.markup import escape

from sunarc.cli.options import AsJson, FollowExif, TimePatternOption, print_json, print_table
from sunarc.common.errors import InputError, disk_errors
from sunarc.common.findings import Finding, FindingError
from sunarc.common.foreign_files import name_text
from sunarc.imager.archive.database.state_folder import as_owner
from sunarc.imager.checks import TriedResult, try_first
from sunarc.imager.settings.file_text import NEW_FILE, Value, read_text, replace_values, value_in
from sunarc.imager.settings.load import parse_settings
from sunarc.imager.settings.model import UTC, zone_exists
from sunarc.sky.site import parse_angle
from sunarc.sources.time_patterns import checked_pattern

_SOURCES = ("aravis", "folder", "http", "rtsp")
_TRIES = 5
"""Answers to a question that may be wrong, one after the other."""


class _SettingQuestion(NamedTuple):
    """A question: its setting and option, its text, the reader of the answer, and the value where nobody answers."""

    setting: str
    option: str
    text: str
    read: Callable[[str], Value | None]
    default: str | None = None


def _make_number_reader(option: str) -> Callable[[str], Value]:
    def read(text: str) -> Value:
        try:
            return float(text.strip().removesuffix("m").replace(",", "."))
        except ValueError:
            raise FindingError(option, Finding("answer_not_number", {"given": text})) from None

    return read


def _parse_source(text: str) -> Value:
    if text not in _SOURCES:
        raise FindingError("--source", Finding("answer_unknown", {"given": text, "choices": ", ".join(_SOURCES)}))
    return text


_SITE = (
    _SettingQuestion("site.latitude", "--latitude", "Latitude, decimal or as 36°36'14\"N",
              lambda text: parse_angle(text, question="--latitude", axis="NS")),
    _SettingQuestion("site.longitude", "--longitude", "Longitude, decimal (east positive) or as 97°29'05\"W",
              lambda text: parse_angle(text, question="--longitude", axis="EW")),
    _SettingQuestion("site.altitude", "--altitude", "Altitude, metres above sea level",
              _make_number_reader("--altitude")),
    _SettingQuestion("source", "--source", f"Where the images come from: {', '.join(_SOURCES)}",
              _parse_source, "aravis"),
)  # fmt: skip
_OF_SOURCE = {
    "aravis": _SettingQuestion("camera.address", "--camera", "The camera's IP address", str.strip),
    "folder": _SettingQuestion("folder.path", "--folder", "The folder that another program fills", str.strip),
    "http": _SettingQuestion("http.url", "--url", "The address of the camera's picture", str.strip),
    "rtsp": _SettingQuestion("rtsp.url", "--url", "The address of the camera's stream", str.strip),
}
_WRITING = {"readable": "no", "mirrored": "yes", "unknown": None}
"""Whether the image is mirrored, by how writing in it looks."""


def _parse_writing(text: str) -> Value | None:
    if text.strip() not in _WRITING:
        given = {"given": text, "choices": ", ".join(_WRITING)}
        raise FindingError("--writing", Finding("answer_unknown", given))
    return _WRITING[text.strip()]


_MIRRORED = _SettingQuestion(
    "calibration.mirrored",
    "--writing",
    f"Writing in the picture, as on a sign or a wall: {', '.join(_WRITING)}",
    _parse_writing,
    "unknown",
)
_LEVEL = _SettingQuestion(
    "calibration.level_within_deg",
    "--level-within",
    "Is the camera level to 5 degrees? Largest tilt, degrees",
    _make_number_reader("--level-within"),
    "5",
)


def _parse_pattern(given: str) -> str:
    return checked_pattern(given.strip(), field="--time-pattern")


_OFFSET = _SettingQuestion(
    "folder.utc_offset",
    "--utc-offset",
    "Hours that the times in names are ahead of UTC (0 for UTC), or a zone as Europe/Berlin",
    str.strip,
)
_PATTERN = _SettingQuestion(
    "folder.time_pattern", "--time-pattern", "Pattern of the names without suffix, as %Y%m%d_%H%M%S", _parse_pattern
)
_ASKED_BY_FAULT = {"file_time_zone": _OFFSET, "file_time_unknown": _PATTERN, "file_time_ambiguous": _PATTERN}
"""Questions that answer a fault in a picture's time."""


def init(
    file: Annotated[Path, typer.Argument(help="Settings file to write, or to change.")] = Path("sunarc.toml"),
    *,
    latitude: Annotated[str | None, typer.Option(help="Decimal degrees, north positive, or as 36°36'14\"N.")] = None,
    longitude: Annotated[str | None, typer.Option(help="Decimal degrees, east positive, or as 97°29'05\"W.")] = None,
    altitude: Annotated[str | None, typer.Option(help="Metres above sea level.")] = None,
    timezone: Annotated[
        str | None, typer.Option(help="IANA name of the zone of local times, as Pacific/Auckland; else the host's.")
    ] = None,
    source: Annotated[str | None, typer.Option(help="aravis (a GenICam camera), folder, http or rtsp.")] = None,
    camera: Annotated[
        list[str] | None, typer.Option(help="Address of a GigE camera; may be given often, none is searched for.")
    ] = None,
    folder: Annotated[Path | None, typer.Option(help="Folder that another program fills with images.")] = None,
    url: Annotated[
        str | None, typer.Option(help="Address of the camera's picture (JPEG, PNG), or of its RTSP stream.")
    ] = None,
    token_file: Annotated[Path | None, typer.Option(help="File with USER:PASSWORD for --url.")] = None,
    utc_offset: Annotated[
        str | None, typer.Option(help="How far times in names are ahead of UTC: hours, or a zone as Europe/Berlin.")
    ] = None,
    level_within: Annotated[
        str | None, typer.Option(help="Largest tilt of the camera, degrees; 5 for one that is level.")
    ] = None,
    time_pattern: TimePatternOption = None,
    follow_exif: FollowExif = False,
    writing: Annotated[
        str | None, typer.Option(help="How writing in the picture looks: readable, mirrored or unknown.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="The camera's name in the archive and in documents.")] = None,
    state: Annotated[Path | None, typer.Option(help="Folder of the database and the images.")] = None,
    port: Annotated[int | None, typer.Option(help="Of the dashboard and the REST service.")] = None,
    picture: Annotated[Path, typer.Option(help="Write a small picture of the source here, the sun marked.")] = Path(
        "sunarc-init.png"
    ),
    as_json: AsJson = False,
) -> None:
    """Ask for the site and the source, try the rest, and write a settings file; exit 1 where a trial fails.

    Called again it changes what is given and keeps the rest of the file, comments too. Without a terminal nothing is
    asked: what is missing is named, and nothing written.

    Example: sunarc init --latitude 36.604 --longitude 97.485W --altitude 318 --folder /srv/allsky/images
    """  # fmt: skip
    given = {
        "site.latitude": latitude,
        "site.longitude": longitude,
        "site.altitude": altitude,
        "source": source or _choose_source(camera, folder, url),
        "camera.address": camera[0] if camera else None,
        "folder.path": None if folder is None else str(folder.absolute()),
        "http.url": url,
        "rtsp.url": url,
        "calibration.mirrored": writing,
        "folder.utc_offset": utc_offset,
        "folder.time_pattern": time_pattern,
        "calibration.level_within_deg": level_within,
    }
    with as_owner(file.parent):
        before = read_text(file)
    answers = _Answers(NEW_FILE if before is None else before, given, ask=sys.stdin.isatty())
    plain: Mapping[str, Value | None] = {
        "name": name,
        "state": None if state is None else str(state.absolute()),
        "api.port": port,
        "site.timezone": timezone,
        "folder.follow_exif": follow_exif or None,
    }
    answers.set(plain)
    if answers.value("site.timezone") is None:
        answers.set({"site.timezone": _read_host_zone()})
    for question in _SITE:
        answers.answer(question)
    kind = str(answers.value("source") or "aravis")
    _require_source(kind, camera=camera, folder=folder, url=url)
    answers.answer(_OF_SOURCE[kind])
    if token_file is not None and kind in {"http", "rtsp"}:
        answers.set({f"{kind}.token_file": str(token_file.absolute())})
    answers.answer(_MIRRORED)
    for optional in (_OFFSET, _PATTERN):
        answers.answer(optional, needed=False)
    answers.answer(_LEVEL, needed=answers.ask)  # where nobody is asked, the first fit asks
    results = _try_settings(answers, file, addresses=camera or [], picture=picture)
    changed = {} if before == answers.text else answers.changes
    if before != answers.text:
        _write_settings(file, answers.text)
    _print_result(file, changed, results, as_json=as_json)
    if any(result.outcome == "fail" for result in results):
        raise typer.Exit(1)


def _read_host_zone() -> str:
    """Return the IANA name of this computer's time zone; UTC where it has no name."""
    of_file = os.path.realpath("/etc/localtime").partition("/zoneinfo/")[2]
    name = os.environ.get("TZ", of_file).removeprefix(":")
    return name if name and zone_exists(name) else UTC


def _choose_source(camera: list[str] | None, folder: Path | None, url: str | None) -> str | None:
    """Return the source that the other options mean; None without one, or with several."""
    asked = "rtsp" if url is not None and url.lower().startswith("rtsp") else "http"
    given = {"aravis": camera, "folder": folder, asked: url}
    meant = [source for source, value in given.items() if value]
    return meant[0] if len(meant) == 1 else None


def _require_source(kind: str, *, camera: list[str] | None, folder: Path | None, url: str | None) -> None:
    """Raise where an option of another source is given."""
    fitting = _OF_SOURCE[kind].option
    for option, value in (("--camera", camera), ("--folder", folder), ("--url", url)):
        if value and option != fitting:
            raise FindingError(option, Finding("answer_contradicts", {"source": kind, "option": fitting}))


class _Answers:
    """A settings file's text, and the answers to questions that go into it."""

    def __init__(self, text: str, given: Mapping[str, str | None], *, ask: bool) -> None:
        self.text = text
        self.changes: dict[str, Value] = {}
        self.ask = ask
        self._given = given

    def value(self, setting: str) -> Any:  # noqa: ANN401 - whatever TOML holds
        """Return the value that the file has now."""
        return value_in(self.text, setting)

    def set(self, values: Mapping[str, Value | None]) -> None:
        """Set the values that are not None."""
        for setting, value in values.items():
            if value is not None and value != self.value(setting):
                self.text = replace_values(self.text, {setting: value})
                self.changes[setting] = value

    def answer(self, question: _SettingQuestion, *, needed: bool = True) -> None:
        """Take the answer that was given; ask where the file has none and it is needed."""
        given = self._given.get(question.setting)
        if given is not None:
            self.set({question.setting: question.read(given)})
        elif needed and self.value(question.setting) is None:
            self.set({question.setting: self._ask_question(question)})

    def _ask_question(self, question: _SettingQuestion) -> Value | None:
        if not self.ask:
            if question.default is not None:
                return question.read(question.default)
            raise FindingError(question.setting, Finding("answer_missing", {"option": question.option}))
        for left in reversed(range(_TRIES)):
            try:
                return question.read(str(typer.prompt(question.text, default=question.default, err=True)))
            except InputError as error:
                if not left:
                    raise
                print(f"sunarc: {error}", file=sys.stderr)
        raise AssertionError  # the last one returns or raises


def _try_settings(answers: _Answers, file: Path, *, addresses: list[str], picture: Path) -> list[TriedResult]:
    """Return the outcome of the trials; where a picture's time needs one more answer, ask for it, and try again."""
    while True:
        settings = parse_settings(answers.text, where=str(file))
        results = list(try_first(settings, addresses=addresses, picture=picture))
        codes = {code for result in results for code in result.codes}
        wanted = [question for code, question in _ASKED_BY_FAULT.items() if code in codes]
        if not answers.ask or not wanted or answers.value(wanted[0].setting) is not None:
            return results
        answers.answer(wanted[0])


def _write_settings(file: Path, text: str) -> None:
    """Write a file whole or not at all, with the owner and the rights that it has."""
    with as_owner(file.parent), disk_errors(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=file.parent, prefix=f".{file.name}.")
        try:
            with os.fdopen(handle, "w", encoding="utf-8", newline="") as out:
                out.write(text)
                former = file.stat() if file.exists() else None
                os.fchmod(handle, 0o644 if former is None else stat.S_IMODE(former.st_mode))
                if former is not None:
                    with suppress(PermissionError):  # of another user, whose folder this one may write in
                        os.fchown(handle, former.st_uid, former.st_gid)
            Path(temporary).replace(file)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise


def _print_result(file: Path, changed: Mapping[str, Value], results: list[TriedResult], *, as_json: bool) -> None:
    failed = [result for result in results if result.outcome == "fail"]
    following = f"sunarc init {file} …" if failed else f"sunarc check --config {file}"
    if as_json:
        checks = [result._asdict() for result in results]
        print_json({"file": name_text(file), "changed": dict(changed), "checks": checks, "next": following})
        return
    print_table(("", "", ""), [[result.outcome, result.what, escape(result.text)] for result in results])
    print(f"wrote {file}: {', '.join(changed)}" if changed else f"{file} is as it was")
    print(
        f"next: {following}" if not failed else f"next: correct what failed, by the option that it names: {following}"
    )
