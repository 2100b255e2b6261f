"""A known lens in a new pose.

Map: `stated` what a calibration says of its errors, jointly · `condition` that held to sightings, false ones among them
· `turn` the turn that most of them agree on · `seen` their noise · `estimate_pose` the calibration of the new pose · `offset`
how it stood on a day.
"""

from sunarc.calibration.pose.daily_offset import PoseOffset, daily_pose_offset
from sunarc.calibration.pose.estimate_pose import estimate_pose

__all__ = ["PoseOffset", "daily_pose_offset", "estimate_pose"]
