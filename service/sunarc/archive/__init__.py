"""What we remember: cameras, pose epochs, sightings, days, calibrations, refits and events, in one SQLite file.

values.py: what goes in and comes out · tables.py: the head revision · engine.py: connections and transactions ·
schema.py: revisions, checks · migrating.py: alembic's part · copies.py: backups and their way back · sightings.py
(with columns.py), calibrations.py (with documents.py, validity.py), history.py, epoch_closing.py, used.py,
journal.py: the parts of `Archive` · archive.py: the whole · images.py: composites on disk · reserve.py: the
database's room beside them · csv_files.py: the files people hand us.
"""

from sunarc.archive.archive import Archive, open_archive
from sunarc.archive.copies import backup, backup_into, restore
from sunarc.archive.csv_files import (
    SightingTable,
    parse_time,
    read_pairs,
    read_sightings,
    write_columns,
    write_sightings,
)
from sunarc.archive.doubts import ELSEWHERE, LENS_CHANGED, MOVED
from sunarc.archive.images import DiskOptions, DiskUsage, ImageStore
from sunarc.archive.reserve import Reserve
from sunarc.archive.schema import Check, check, downgrade, head_revision, require_file, upgrade
from sunarc.archive.seen import sun_point_of
from sunarc.archive.values import (
    CalibrationRecord,
    CalibrationState,
    CameraRecord,
    Day,
    DayVerdict,
    Event,
    EventSeverity,
    PoseEpoch,
    Refit,
    RefitState,
    SunPoint,
    SunPointColumns,
)

__all__ = [
    "ELSEWHERE",
    "LENS_CHANGED",
    "MOVED",
    "Archive",
    "CalibrationRecord",
    "CalibrationState",
    "CameraRecord",
    "Check",
    "Day",
    "DayVerdict",
    "DiskOptions",
    "DiskUsage",
    "Event",
    "EventSeverity",
    "ImageStore",
    "PoseEpoch",
    "Refit",
    "RefitState",
    "Reserve",
    "SightingTable",
    "SunPoint",
    "SunPointColumns",
    "backup",
    "backup_into",
    "check",
    "downgrade",
    "head_revision",
    "open_archive",
    "parse_time",
    "read_pairs",
    "read_sightings",
    "require_file",
    "restore",
    "sun_point_of",
    "upgrade",
    "write_columns",
    "write_sightings",
]
