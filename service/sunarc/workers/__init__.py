"""Workers of the service: `capture`, `sightings`, `night`, `images`, `timing`, `calibrating`, `feeding`, `pushing`."""

from sunarc.workers.bounded_queue import DropOldestQueue
from sunarc.workers.calibrating.judge_days import DayJudge
from sunarc.workers.calibrating.lens_prior_file import FirstPose, LensPriorOptions, read_lens_prior
from sunarc.workers.calibrating.monitor import WatchWorker
from sunarc.workers.calibrating.provisional_pose import ProvisionalPoseEstimator
from sunarc.workers.calibrating.refit import RefitOptions, RefitWorker
from sunarc.workers.capture.capture import CaptureOptions, CaptureWorker
from sunarc.workers.capture.overdue_sightings import OverdueSightings
from sunarc.workers.capture.replay import ReplayWorker
from sunarc.workers.capture.sun_exposure_control import SunExposures
from sunarc.workers.condition_times import ConditionTimesWorker
from sunarc.workers.database_file import DatabaseWorker, StoreRoomWorker
from sunarc.workers.disk_space import DiskWorker
from sunarc.workers.feeding.feed import FeedWorker
from sunarc.workers.feeding.hub_connection import HubConnection, HubOptions, HubRefusal
from sunarc.workers.fit_input import points_of
from sunarc.workers.housekeeping import HousekeepingWorker
from sunarc.workers.images.compose import ComposeWorker
from sunarc.workers.images.image_metadata import image_document
from sunarc.workers.neighbours import cross_check_fleet
from sunarc.workers.night.exposures import DARK_ZENITH_DEG, NightCapture, NightExposures
from sunarc.workers.night.moon import MoonCapture
from sunarc.workers.night.moon_exposures import MoonExposures
from sunarc.workers.night.named_stars import star_view, surest_named
from sunarc.workers.night.night import NightWorker
from sunarc.workers.night.options import NightOptions
from sunarc.workers.night.warm import WarmPixelMap
from sunarc.workers.nightly import NightlyOptions, NightlyWork, nightly_jobs
from sunarc.workers.pushing.mqtt import MqttBroker
from sunarc.workers.pushing.options import PushOptions
from sunarc.workers.pushing.push import PushWorker, Sink
from sunarc.workers.pushing.record import NoticeWorker
from sunarc.workers.pushing.webhook import Webhook, webhook_name
from sunarc.workers.sensor import SensorOptions
from sunarc.workers.sightings.detect import DetectWorker
from sunarc.workers.sightings.frozen_frames import FrozenFrames
from sunarc.workers.sightings.sun_prediction import SunPredictor
from sunarc.workers.sightings.write_buffer import SightingWriteBuffer
from sunarc.workers.timing.clock_watch import UNKNOWN_ERROR_S, ClockOptions, ClockWatch
from sunarc.workers.timing.frame_time import FrameTime

__all__ = [
    "DARK_ZENITH_DEG",
    "UNKNOWN_ERROR_S",
    "CaptureOptions",
    "CaptureWorker",
    "ClockOptions",
    "ClockWatch",
    "ComposeWorker",
    "ConditionTimesWorker",
    "DatabaseWorker",
    "DayJudge",
    "DetectWorker",
    "DiskWorker",
    "DropOldestQueue",
    "FeedWorker",
    "FirstPose",
    "FrameTime",
    "FrozenFrames",
    "HousekeepingWorker",
    "HubConnection",
    "HubOptions",
    "HubRefusal",
    "LensPriorOptions",
    "MoonCapture",
    "MoonExposures",
    "MqttBroker",
    "NightCapture",
    "NightExposures",
    "NightOptions",
    "NightWorker",
    "NightlyOptions",
    "NightlyWork",
    "NoticeWorker",
    "OverdueSightings",
    "ProvisionalPoseEstimator",
    "PushOptions",
    "PushWorker",
    "RefitOptions",
    "RefitWorker",
    "ReplayWorker",
    "SensorOptions",
    "SightingWriteBuffer",
    "Sink",
    "StoreRoomWorker",
    "SunExposures",
    "SunPredictor",
    "WarmPixelMap",
    "WatchWorker",
    "Webhook",
    "cross_check_fleet",
    "image_document",
    "nightly_jobs",
    "points_of",
    "read_lens_prior",
    "star_view",
    "surest_named",
    "webhook_name",
]
