"""The source of images that is a folder which another program fills: each is dated, read and stored, once."""

from __future__ import annotations

import heapq
import logging
import math
import threading
from collections import deque
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass
from datetime import date, datetime, timedelta
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from sunarc.common.array_types import Image
from sunarc.common.errors import InputError, OutsideError
from sunarc.common.findings import Finding, FindingError
from sunarc.common.foreign_files import MOST_BYTES, is_regular, name_path, name_text
from sunarc.common.utc import DAY_S, utc_time
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.pictures_of_one_time import TWO_PICTURES
from sunarc.imager.archive.seen_files import SeenFile
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.cameras.options import WHOLE_SECONDS_S, FolderOptions
from sunarc.imager.live import folder_files
from sunarc.imager.live.camera_record import ResizedPictures
from sunarc.imager.live.file_frames import make_file_frame
from sunarc.imager.live.folder_conditions import DATED_AGAIN, FUTURE, AheadOfClock, ArrivalTimes, LeftOut, time_rules
from sunarc.imager.live.live_images import LiveImage, LiveImages
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.loop import DropOldestQueue, Loop
from sunarc.imager.runtime.status import CameraStatus, CaptureStatus, Reason, StatusRegistry, condition
from sunarc.imager.workers.calibrating.day_judge import LearnedCadence
from sunarc.imager.workers.clock_watch import FrameTime
from sunarc.sky.days import solar_date
from sunarc.sky.sun import DARK_ZENITH_DEG
from sunarc.sources import image_files, source_files
from sunarc.sources.expected_sun import MOST_EXPOSURES
from sunarc.sources.image_times import TimedFrame, name_sidecar, timed_frames
from sunarc.sources.index import at_night
from sunarc.sources.name_times import time_in_name
from sunarc.sources.sources import content_hash, open_folder

_log = logging.getLogger(__name__)


class _DatedFile(NamedTuple):
    """A file whose image has a time."""

    file: source_files.SourceFile
    frame: TimedFrame
    content: str


_LATEST = "file_latest"
_FUTURE_S, _YEARS_S = 60.0, 366.0 * DAY_S
_TRUNCATED = "file_truncated"
_HALF_WRITTEN_S = 120.0
"""For so long a file that ends too early may still be written."""
_STACK_S = 20.0
"""How long the other exposures of a stack are waited for, where stacks came before."""
_NO_IMAGE_S, _NO_IMAGE_CADENCES = 600.0, 5.0
_NO_IMAGE = "no_new_image"
_FOLDER_CODES = ("folder_missing", "folder_not_permitted")
_WRITTEN_S = DAY_S
"""For so long after its last change a subfolder is one that images are written into."""
_SILENT_ZENITH_DEG = 85.0
"""Images are expected while the sun is higher."""
_MANY = 500
"""New files of a first listing from which they are an archive, and analysed as one behind the live images."""
_LIVE = timedelta(minutes=15)
_AGAIN_S = 30.0
_SIZES = 15
_LATE_S = 600.0
"""After the last late image its day is judged, and a move looked for."""
_GONE = timedelta(days=30)
_PREFIXES = 12
"""So many images in a row with other names are those of a camera that was renamed."""
_AT_ONCE = 32
"""Complete files that are dated before others are looked for."""
_NEWEST = 60
_SHOWN = frozenset({".jpg", ".jpeg", ".png"})


@dataclass(eq=False)
class FolderWorker:
    """Worker that follows a folder and reads each new image once.

    Parameters
    ----------
    options : which folder, and how it is read.
    camera : its archive and site.
    images : looks for the sun.
    clock, frame_time : real time, and that of the images.
    sun_zenith_deg : down to where the sun is looked for.
    cadence : of the images.
    board : where the folder's state is shown.
    night : takes the images of the night; None: they are left out.
    archive_of : asked to analyse the folder's older files as an archive, behind the live images.
    judge_again : called with the day of an image that came late.
    look_again : called a while after the last late image: a move may be seen in such images alone.
    """

    options: FolderOptions
    _: KW_ONLY
    camera: CameraArchive
    images: LiveImages
    clock: Clock
    frame_time: FrameTime
    sun_zenith_deg: float
    apparent_zenith: Callable[[datetime], float]
    cadence: LearnedCadence
    board: StatusRegistry
    night: DropOldestQueue[Frame] | None = None
    archive_of: Callable[[Sequence[source_files.SourceFile]], None] = lambda _: None
    judge_again: Callable[[date], None] = lambda _: None
    look_again: Callable[[], None] = lambda: None

    def __post_init__(self) -> None:
        """Begin with no file listed."""
        self._rules = time_rules(self.options)
        self._root = self.options.path
        self._source = open_folder(self._root, follow_exif=self.options.follow_exif)
        self._listing = folder_files.FolderListing(self._root, self.options.files)
        self._settling = folder_files.Settling(self._root, self.options.settle_s)
        self._left_out = LeftOut(self.board)
        self._resized = ResizedPictures(self.camera.archive, self.camera.name)
        self._arrivals = ArrivalTimes(self.board, settle_s=self.options.settle_s)
        self._stamps: dict[str, str] = {}
        self._verdicts: dict[str, str] = {}
        self._ahead = AheadOfClock(self.clock)
        self._remembers = False
        self._ready: dict[str, tuple[source_files.SourceFile, float]] = {}
        self._late: dict[str, source_files.SourceFile] = {}
        self._n_in_hand = 0
        self._again: dict[str, float] = {}
        self._late_days: dict[date, float] = {}
        self._late_s: float | None = None
        self._prefixes: deque[str] = deque(maxlen=_PREFIXES)
        self._usual: str | None = None
        self._stack_size = 1
        self._listed_s = -math.inf
        self._came_s: float | None = None
        self._newest: tuple[str, datetime] | None = None
        self._n_frames = 0
        self._reads = False
        self._last_night: datetime | None = None

    # What is done again and again.

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Follow the folder until stopped."""
        loop = Loop(self.clock, stop, heartbeat)
        watch = folder_files.FolderWatch(
            self._root, self.clock, poll_s=self.options.poll_s, polling=self.options.polling
        )
        try:
            for _ in loop.turns():
                if self.clock.monotonic() - self._listed_s >= watch.list_every_s and not self.list_new():
                    watch.restart()
                    loop.wait(min(self.options.poll_s, _AGAIN_S))
                    continue
                if not self.work(heartbeat):
                    self.note_names(watch.wait(loop, min(self.options.settle_s, 1.0) or 0.2))
        finally:
            watch.close()

    def list_new(self) -> bool:
        """List the new files of the folder; return whether it could be read."""
        now_s = self.clock.monotonic()
        try:
            if not self._remembers:
                self._read_seen_files()
            listed = list(self._listing.files(now_ns=int(1e9 * self.clock.now().timestamp())))
        except OSError as error:
            self._show_unreadable_folder(error)
            return False
        except OutsideError as error:
            _log.warning("the files that were seen cannot be read from the archive: %s", error)
            return False
        self._listed_s = now_s
        self._show_denied()
        self.board.note(camera=CameraStatus(name=self.camera.name, connected=True, address=name_text(self._root)))
        new = [file for file in listed if self._is_new(file)]
        if not self._reads:
            self._reads = True
            self._divide_first_listing(listed, new)
        else:
            for file in new:
                self._settling.add(file, now_s)
        return True

    def note_names(self, names: Iterable[str]) -> None:
        """Take note of files that the file system reports as changed."""
        now_s = self.clock.monotonic()
        for file in self._list_present_files(name for name in names if folder_files.is_image(name, self.options.files)):
            if self._is_new(file):
                self._settling.add(file, now_s)

    def _list_present_files(self, names: Iterable[str]) -> Iterator[source_files.SourceFile]:
        for name in names:
            with suppress(OSError):  # it is gone
                yield folder_files.source_file(name, (self._root / name_path(name)).stat())

    def work(self, heartbeat: Callable[[], None] = lambda: None) -> bool:
        """Process the images that are complete, live ones before late ones; return whether there may be more."""
        now_s = self.clock.monotonic()
        for file in self._settling.settled(now_s):
            self._ready[file.name] = (file, now_s)
        self._check_arrival(now_s)
        self.take_late(self._list_present_files(self._ahead.passed()))
        for name, due_s in list(self._again.items()):
            if now_s >= due_s:
                del self._again[name]
                self.note_names([name])
        ready = self._newest_ready()
        if ready:
            self._came_s = now_s
            waits = bool(self._ready)
            self._take_files([file for file, _ in ready.values()], heartbeat, live=True, since_s=ready)
            return waits or bool(self._late)
        if self._late:
            some = [self._late.pop(name) for name in list(self._late)[:1]]
            self._take_files(some, heartbeat, live=False)
            return True
        if self._late_s is not None and (now_s - self._late_s) * self.frame_time.speed >= _LATE_S:
            self._late_s = None
            self.look_again()
        return False

    def _newest_ready(self) -> dict[str, tuple[source_files.SourceFile, float]]:
        """Return some complete files, those that came last first: a live one does not wait for thousands of others."""
        names = heapq.nsmallest(_AT_ONCE, self._ready, key=lambda name: (-self._ready[name][1], name))
        names.sort(key=lambda name: (self._ready[name][1], name))
        return {name: self._ready.pop(name) for name in names}

    @property
    def n_waiting(self) -> int:
        """Return how many files have arrived whose sightings are not stored yet."""
        return len(self._settling) + len(self._ready) + len(self._late) + self._n_in_hand + len(self._again)

    @property
    def newest_picture(self) -> Path | None:
        """The newest image that a browser shows; None without one, or if it is gone."""
        if self._newest is None or PurePosixPath(self._newest[0]).suffix.lower() not in _SHOWN:
            return None
        path = self._root / name_path(self._newest[0])
        return path if is_regular(path) else None

    def pictures(self, *, since: datetime | None, until: datetime | None, limit: int) -> list[tuple[datetime, Path]]:
        """Return times and files of at most so many used pictures with since <= time < until, the newest first.

        Those that a browser does not show, and those that are gone, are left out.
        """
        seen = self.camera.archive.seen_files.used(self.camera.name, since=since, until=until, limit=limit)
        found = [(one.time, self._root / name_path(one.file)) for one in seen if one.time is not None]
        return [(time, path) for time, path in found if path.suffix.lower() in _SHOWN and is_regular(path)]

    @property
    def waiting_days(self) -> set[date]:
        """The solar days of which files wait, or came late a moment ago: they are judged afterwards."""
        now_s = self.clock.monotonic()
        self._late_days = {
            day: at for day, at in self._late_days.items() if (now_s - at) * self.frame_time.speed < _LATE_S
        }
        named = (time_in_name(name) for name in self._late)
        return {*self._late_days, *(self._get_solar_date(one.time.timestamp()) for one in named if one is not None)}

    # Which files are new.

    def _read_seen_files(self) -> None:
        """Read which files were seen; those without a time are dated again, for the settings may have changed."""
        seen = self.camera.archive.seen_files
        self._stamps, self._remembers = dict(seen.stamps(self.camera.name)), True
        self._verdicts = dict(seen.left_out(self.camera.name, DATED_AGAIN))
        self.images.repetitions.resume()
        newest = seen.newest(self.camera.name, limit=_NEWEST)
        if newest and newest[0].time is not None:
            self._newest = (newest[0].file, newest[0].time)
        named = (time_in_name(one.file) for one in newest if one.code is None)
        self._usual = next((one.prefix for one in named if one is not None), None)

    def _is_new(self, file: source_files.SourceFile) -> bool:
        name = file.name
        seen = self._stamps.get(name)
        return seen != file.stamp and name not in self._ready and name not in self._late and name not in self._again

    def _divide_first_listing(
        self, listed: Sequence[source_files.SourceFile], new: Sequence[source_files.SourceFile]
    ) -> None:
        """Divide the files at the start: the newest are live, a few are late, many are an archive."""
        now = self.clock.now().timestamp()
        recent = [file for file in new if now - folder_files.changed_s(file) < _LIVE.total_seconds()]
        for file in recent:
            self._settling.add(file, self.clock.monotonic())
        older = [file for file in new if now - folder_files.changed_s(file) >= _LIVE.total_seconds()]
        self._register_camera(sorted(listed, key=folder_files.changed_s))
        if len(older) > _MANY:
            self.archive_of(older)
            for file in older:
                self._stamps[file.name] = file.stamp
        else:
            self._late.update((file.name, file) for file in older)
        self.take_late(
            file for file in listed if self._stamps.get(file.name) == file.stamp and file.name in self._verdicts
        )
        self._forget_missing({file.name for file in listed})

    def take_late(self, files: Iterable[source_files.SourceFile]) -> None:
        """Process files after the live ones."""
        self._late.update((file.name, file) for file in files)

    def _forget_missing(self, present: set[str]) -> None:
        """Remove files that are gone from the folder from the record, which would grow for ever."""
        gone = [name for name in self._stamps if name not in present]
        if not present or not gone:
            return
        try:
            self.camera.archive.seen_files.forget(self.camera.name, gone, before=self.clock.now() - _GONE)
        except OutsideError as error:
            _log.warning("files that are gone are not forgotten: %s", error)

    def _register_camera(self, files: Sequence[source_files.SourceFile]) -> None:
        if self.images.size is None and files:
            found = (image_files.image_size(self._source, file.name) for file in files[-_SIZES:])
            self.images.register(
                [one for one in found if one is not None and one[0] * one[1] <= source_files.MOST_PIXELS]
            )

    # What is done with a file.

    def _take_files(
        self,
        files: Sequence[source_files.SourceFile],
        heartbeat: Callable[[], None],
        *,
        live: bool,
        since_s: dict[str, tuple[source_files.SourceFile, float]] | None = None,
    ) -> None:
        self._register_camera(files)
        by_time: dict[datetime, list[_DatedFile]] = {}
        for file in files:
            dated = self._date_file(file)
            if dated is not None and live and not self.frame_time.follows_camera:
                self._arrivals.note(dated.frame.time, utc_time(folder_files.changed_s(file)))
            if dated is not None and live and not self._is_recent(dated.frame.time):
                self._late[file.name] = file
            elif dated is not None:
                by_time.setdefault(dated.frame.time, []).append(dated)
            heartbeat()
        for time in sorted(by_time):
            if live and since_s is not None and self._wait_for_stack(by_time[time], since_s):
                del by_time[time]
        while by_time:
            self._n_in_hand = sum(map(len, by_time.values()))
            time = min(by_time)
            try:
                self._take_images(time, by_time[time], live=live)
            except (OutsideError, InputError) as error:
                self._try_later(by_time[time], error)
            del by_time[time]
            heartbeat()
        self._n_in_hand = 0

    def _is_recent(self, time: datetime) -> bool:
        """Return whether an image goes before those that come late; in a simulation times are compared with theirs."""
        if self.frame_time.speed != 1.0:
            return self._newest is None or time > self._newest[1] - _LIVE
        return time > self.frame_time.now() - _LIVE

    def _wait_for_stack(
        self, members: Sequence[_DatedFile], since_s: dict[str, tuple[source_files.SourceFile, float]]
    ) -> bool:
        """Return whether more exposures of a stack are awaited; those present are then put back into the queue."""
        now_s = self.clock.monotonic()
        oldest_s = min(since_s[one.file.name][1] for one in members)
        if len(members) >= self._stack_size or now_s - oldest_s >= _STACK_S:
            return False
        for one in members:
            self._ready[one.file.name] = (one.file, since_s[one.file.name][1])
        return True

    def _date_file(self, file: source_files.SourceFile) -> _DatedFile | None:
        """Return a file with the time of its image; None, and the reason stored, where it is left out."""
        name = file.name
        try:
            frame = self._find_time(file)
            if self._is_ahead_of_clock(file, frame.time):
                return None
            content = content_hash(source_files.read_content(self._source, name))
        except FindingError as error:
            self._leave_out(file, self._explain_missing_time(name, error.finding))
            return None
        except OSError as error:
            self._leave_out(file, Finding(source_files.NOT_READ, {"error": error.strerror or str(error)}))
            return None
        return _DatedFile(file, frame, content)

    def _find_time(self, file: source_files.SourceFile) -> TimedFrame:
        """Return when the image of a file was taken; FindingError where that cannot be."""
        if file.size > MOST_BYTES:
            raise FindingError(file.name, Finding("file_too_large", {"bytes": file.size, "most": MOST_BYTES}))
        sidecar = name_sidecar(file.name)
        names = {sidecar} if is_regular(self._root / name_path(sidecar)) else set[str]()
        frame = timed_frames(self._source, file.name, self._rules, names=names)[0]
        ahead_s = (frame.time - self.frame_time.now()).total_seconds()
        most_s = (self.options.clock_error_s or WHOLE_SECONDS_S) + _FUTURE_S
        if self.frame_time.speed == 1.0 and ahead_s > most_s:
            self._verdicts.pop(file.name, None)
            self._ahead.note(file.name, ahead_s - most_s)
            raise FindingError(file.name, Finding("file_time_future", {"ahead_s": ahead_s}))
        return frame

    def _is_ahead_of_clock(self, file: source_files.SourceFile, time: datetime) -> bool:
        """Return whether an image was ahead of a clock that no file's change shows to have been years behind."""
        behind_s = time.timestamp() - folder_files.changed_s(file)
        return self._verdicts.pop(file.name, "") == FUTURE and behind_s < _YEARS_S

    def _explain_missing_time(self, name: str, finding: Finding) -> Finding:
        """Return the finding of a file without a time; one that is often written over copies the newest image."""
        written_over = name in self._stamps
        others = self._newest is not None and self._newest[0] != name
        return Finding(_LATEST) if finding.code == "file_time_unknown" and written_over and others else finding

    def _take_images(self, time: datetime, new: list[_DatedFile], *, live: bool) -> None:
        """Process the images of one time, and store that they were seen."""
        zenith = self.apparent_zenith(time)
        new = self._select_by_prefix(new)
        if not new:
            return
        members = self.camera.archive.seen_files.at(self.camera.name, time)
        contents = {one.content for one in members if one.file not in {each.file.name for each in new}}
        for one in [one for one in new if one.content in contents]:
            self._leave_out(one.file, Finding("file_copy", {"file": PurePosixPath(one.file.name).name}), one)
            new.remove(one)
        if not new:
            return
        if zenith >= self.sun_zenith_deg:
            self._take_night_image(time, new, zenith, live=live)
        else:
            self._take_day_images(time, new, members, live=live)
        self._note_newest_image(time, new, live=live)

    def _take_day_images(
        self, time: datetime, new: Sequence[_DatedFile], members: Sequence[SeenFile], *, live: bool
    ) -> None:
        stack = {one.file.name: _make_live_image(one) for one in new}
        stack |= {one.file.name: _make_live_image(one) for one in self._read_other_exposures(members, without=stack)}
        every = [stack[name] for name in sorted(stack)]
        if len(every) > MOST_EXPOSURES:
            for one in new:
                self._leave_out(one.file, Finding("file_time_repeated", {"n": len(every), "most": MOST_EXPOSURES}), one)
            return
        self._stack_size = len(every) if live else self._stack_size
        found = dict(zip([one.file for one in every], self.images.take(self._source.address, every), strict=True))
        for one in new:
            finding = found[one.file.name]
            if finding is not None and finding.code == _TRUNCATED and self._may_grow(one.file):
                self._again[one.file.name] = self.clock.monotonic() + _AGAIN_S
            elif finding is None or finding.code == TWO_PICTURES:
                self._mark_seen(one)
                self._left_out.note(one.file.name, finding)
            else:
                self._leave_out(one.file, finding, one)
        if not live:
            day = self._get_solar_date(time.timestamp())
            self._late_days[day] = self._late_s = self.clock.monotonic()
            self.judge_again(day)

    def _read_other_exposures(self, seen: Sequence[SeenFile], *, without: Container[str]) -> Iterator[_DatedFile]:
        """Yield the other exposures of a time, which were read before."""
        for one in seen:
            if one.code is None and one.file not in without:
                with suppress(OSError):  # it is gone
                    dated = self._date_file(
                        folder_files.source_file(one.file, (self._root / name_path(one.file)).stat())
                    )
                    if dated is not None and dated.frame.time == one.time:
                        yield dated

    def _take_night_image(self, time: datetime, new: Sequence[_DatedFile], zenith: float, *, live: bool) -> None:
        """Pass a night image to the night worker; those that arrive after their night are left for `ingest`."""
        takes = self.night is not None and zenith >= DARK_ZENITH_DEG and live
        for one in new:
            later = self._last_night is None or time > self._last_night
            if not takes or not later or self.night is None:
                self._leave_out(one.file, at_night(zenith), one)
                continue
            pixels = image_files.read_one_image(self._source, one.file.name, size=self.images.size)
            if isinstance(pixels, Finding):
                self._leave_out(one.file, pixels, one)
                continue
            self._last_night = time
            self.night.put(
                make_file_frame(_average_colours(pixels), time.timestamp(), one.frame.exposure_us, self._n_frames)
            )
            self._mark_seen(one)

    def _select_by_prefix(self, new: Sequence[_DatedFile]) -> list[_DatedFile]:
        """Return the images with the usual prefix of names; another one becomes usual once the former is gone."""
        kept = []
        for one in new:
            self._note_prefix(one.frame.prefix)
            if one.frame.prefix == self._usual:
                kept.append(one)
            else:
                data = {"prefix": one.frame.prefix, "usual": self._usual or ""}
                self._leave_out(one.file, Finding("file_other_camera", data), one)
        return kept

    def _note_prefix(self, prefix: str) -> None:
        self._prefixes.append(prefix)
        is_gone = len(self._prefixes) == _PREFIXES and self._usual not in self._prefixes
        if self._usual is None or is_gone:
            self._usual = prefix

    def _may_grow(self, file: source_files.SourceFile) -> bool:
        return self.clock.now().timestamp() - folder_files.changed_s(file) < _HALF_WRITTEN_S

    def _note_newest_image(self, time: datetime, new: Sequence[_DatedFile], *, live: bool) -> None:
        """Show the newest image, and set the frame time by it where images are the only clock."""
        self._n_frames += len(new)
        self.board.note(capture=CaptureStatus(frames=self._n_frames))
        if self._newest is None or time >= self._newest[1]:
            self._newest = (new[-1].file.name, time)
            self.board.note(last_frame_at=time)
            if live:
                self.frame_time.note(time)

    def _try_later(self, members: Sequence[_DatedFile], error: OutsideError | InputError) -> None:
        """Have images tried again whose sightings could not be stored."""
        _log.warning("%d images are looked at again later: %s", len(members), error)
        if isinstance(error, OutsideError):
            stored = condition(
                "sightings_not_stored", waiting=len(self._again) + len(members), lost=0, error=str(error)
            )
            self.board.set_condition("sightings_not_stored", stored)
        for one in members:
            self._again[one.file.name] = self.clock.monotonic() + _AGAIN_S

    def _leave_out(self, file: source_files.SourceFile, finding: Finding, dated: _DatedFile | None = None) -> None:
        if finding.code == _TRUNCATED and self._may_grow(file):
            self._again[file.name] = self.clock.monotonic() + _AGAIN_S
            return
        self._left_out.note(file.name, finding)
        if finding.code == source_files.NOT_READ:
            self._again[file.name] = self.clock.monotonic() + _AGAIN_S
            return
        self._write_seen(file, dated, finding.code)
        if finding.code == "file_size_differs" and dated is not None:
            size = int(finding.data["width"]), int(finding.data["height"])
            self.take_late(self._resized.note(file, dated.frame.time, size))

    def _mark_seen(self, one: _DatedFile) -> None:
        self._resized.clear()
        self._write_seen(one.file, one, None)

    def _write_seen(self, file: source_files.SourceFile, dated: _DatedFile | None, code: str | None) -> None:
        """Write a file down as seen; after its sightings, so that a process that dies between reads it again."""
        seen = SeenFile(
            camera=self.camera.name,
            file=file.name,
            stamp=file.stamp,
            content=None if dated is None else dated.content,
            time=None if dated is None else dated.frame.time,
            code=code,
        )
        self._stamps[file.name] = file.stamp
        try:
            self.camera.archive.seen_files.add([seen])
        except OutsideError as error:  # a restart looks at it again, to the same end
            _log.warning("%s is not written down as seen: %s", file.name, error)
        else:
            self.board.set_condition("sightings_not_stored", None)

    # How the folder is.

    def _show_unreadable_folder(self, error: OSError) -> None:
        denied = isinstance(error, PermissionError)
        kind = "folder_not_permitted" if denied else "folder_missing"
        found = Finding(kind, {"folder": name_text(self._root), "error": error.strerror or str(error)})
        self.board.set_one_condition(_FOLDER_CODES, Reason.of(found, severity="not_ready"))
        self.board.note(camera=CameraStatus(name=self.camera.name, connected=False, address=name_text(self._root)))
        self._listing.forget()

    def _show_denied(self) -> None:
        """Set or clear the condition of a subfolder that the program still writes, and the service may not read."""
        one, reason = self._listing.denied, None
        if one is not None and self.clock.now().timestamp() - one.changed_ns / 1e9 < _WRITTEN_S:
            found = Finding(
                "folder_not_permitted",
                {"folder": f"{name_text(self._root)}/{one.name}".rstrip("/"), "error": one.error},
            )
            reason = Reason.of(found)
        self.board.set_one_condition(_FOLDER_CODES, reason)

    def _check_arrival(self, now_s: float) -> None:
        """Set or clear the condition of a folder into which no image comes by day."""
        if self._came_s is None:
            self._came_s = now_s
        now = self.frame_time.now()
        silent_s = (now_s - self._came_s) * self.frame_time.speed
        limit_s = max(_NO_IMAGE_S, _NO_IMAGE_CADENCES * self.cadence.at(now))
        if silent_s < limit_s or self.apparent_zenith(now) > _SILENT_ZENITH_DEG:
            self.board.set_condition(_NO_IMAGE, None)
            return
        file, time = ("none", "") if self._newest is None else self._newest
        stated = time.isoformat(timespec="seconds") if isinstance(time, datetime) else "never"
        found = Finding(_NO_IMAGE, {"minutes": int(silent_s / 60.0), "file": file, "time": stated})
        self.board.set_condition(_NO_IMAGE, Reason.of(found))

    def _get_solar_date(self, unix_s: float) -> date:
        return solar_date(unix_s, longitude=self.camera.site.longitude)


def _make_live_image(one: _DatedFile) -> LiveImage:
    return LiveImage(one.file.name, one.frame.time, one.frame.exposure_us, one.content)


def _average_colours(image: Image) -> Image:
    """Return the mean of an image's colours: the night's detector takes one channel."""
    return image if image.ndim == 2 else image.mean(axis=2).astype(image.dtype)
