"""The database: cameras, pose epochs, sightings, days, calibrations, refits and events, in SQLite or PostgreSQL.

`archive` the class `Archive`, made of `sightings calibrations calibration_states calibration_inputs days_and_events
epoch_closing sighting_revisions file_sightings outbox feeds fleet notices night_images nightly counts housekeeping
condition_times` · `values feed_values cross_check housekeeping_values` its values · `tables types` the schema ·
`engine server store` connections and transactions · `schema migrating` revisions · `outbox feeds feed_rows` what is
sent to a hub · `backup recovery file lock ownership space_reserve` the file on disk · `images` composites ·
`csv_files` sightings as CSV.
"""

from sunarc.archive.archive import Archive, open_archive
from sunarc.archive.backup import backup, backup_into, newest_sound_copy, restore
from sunarc.archive.camera_archive import CameraArchive
from sunarc.archive.cross_check import CrossCheck, CrossChecks, Found
from sunarc.archive.csv_files import (
    SightingTable,
    read_pairs,
    read_sightings,
    write_columns,
    write_sightings,
)
from sunarc.archive.epoch_closing import EPOCH_CLOSED
from sunarc.archive.feed_values import (
    FeedBatch,
    FeedRow,
    FleetCamera,
    Quarantined,
    Reason,
    Refusal,
    feed_lines,
    read_feed_lines,
)
from sunarc.archive.file_sightings import FileSighting, ImageKey, image_key
from sunarc.archive.housekeeping_values import Housekeeping, HousekeepingStep, merged
from sunarc.archive.images import DiskOptions, DiskUsage, ImageStore, write_atomically
from sunarc.archive.lock import lock_holder, lock_state, require_unlocked
from sunarc.archive.night_images import NightImage
from sunarc.archive.nightly import LEAST_KEPT, DaySummary, NightlyRun
from sunarc.archive.notices import (
    CameraState,
    Notice,
    NoticeKind,
    SinkState,
    condition_changes,
    stored_changes,
)
from sunarc.archive.outbox import OutboxPosition
from sunarc.archive.recovery import Recovery, prepare_database, upgrade_present
from sunarc.archive.schema import (
    Check,
    check,
    downgrade,
    head_revision,
    prepare_folder,
    require_file,
    upgrade,
    upgrade_server,
)
from sunarc.archive.seen import sun_point_of
from sunarc.archive.server import server_url
from sunarc.archive.sighting_revisions import ELSEWHERE, FROZEN, LENS_CHANGED, MOVED
from sunarc.archive.sites import require_same_site
from sunarc.archive.space_reserve import Reserve
from sunarc.archive.values import (
    CalibrationRecord,
    CalibrationState,
    CameraRecord,
    Day,
    DayAir,
    DayVerdict,
    Event,
    EventSeverity,
    PoseEpoch,
    Refit,
    RefitState,
    SightingCounts,
    SunPoint,
    SunPointColumns,
)

__all__ = [
    "ELSEWHERE",
    "EPOCH_CLOSED",
    "FROZEN",
    "LEAST_KEPT",
    "LENS_CHANGED",
    "MOVED",
    "Archive",
    "CalibrationRecord",
    "CalibrationState",
    "CameraArchive",
    "CameraRecord",
    "CameraState",
    "Check",
    "CrossCheck",
    "CrossChecks",
    "Day",
    "DayAir",
    "DaySummary",
    "DayVerdict",
    "DiskOptions",
    "DiskUsage",
    "Event",
    "EventSeverity",
    "FeedBatch",
    "FeedRow",
    "FileSighting",
    "FleetCamera",
    "Found",
    "Housekeeping",
    "HousekeepingStep",
    "ImageKey",
    "ImageStore",
    "NightImage",
    "NightlyRun",
    "Notice",
    "NoticeKind",
    "OutboxPosition",
    "PoseEpoch",
    "Quarantined",
    "Reason",
    "Recovery",
    "Refit",
    "RefitState",
    "Refusal",
    "Reserve",
    "SightingCounts",
    "SightingTable",
    "SinkState",
    "SunPoint",
    "SunPointColumns",
    "backup",
    "backup_into",
    "check",
    "condition_changes",
    "downgrade",
    "feed_lines",
    "head_revision",
    "image_key",
    "lock_holder",
    "lock_state",
    "merged",
    "newest_sound_copy",
    "open_archive",
    "prepare_database",
    "prepare_folder",
    "read_feed_lines",
    "read_pairs",
    "read_sightings",
    "require_file",
    "require_same_site",
    "require_unlocked",
    "restore",
    "server_url",
    "stored_changes",
    "sun_point_of",
    "upgrade",
    "upgrade_present",
    "upgrade_server",
    "write_atomically",
    "write_columns",
    "write_sightings",
]
