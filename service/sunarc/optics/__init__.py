"""Camera model: projection, back-projection and derivatives."""

from sunarc.optics.camera import PARAMETER_NAMES, Camera, Param
from sunarc.optics.displacement import Displacement
from sunarc.optics.fast import InverseTable, inverse_table
from sunarc.optics.forward import project, project_fast, project_with_jacobian, project_with_rows_fast
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import PoseAngles, pose_angles, rotation_from_pose_angles, rotation_matrix, rotation_vector
from sunarc.optics.projections import PROJECTIONS, Projection, angle_limit, ideal_angle, ideal_radius
from sunarc.optics.stretch import local_stretch, rising_limit

__all__ = [
    "PARAMETER_NAMES",
    "PROJECTIONS",
    "Camera",
    "Displacement",
    "InverseTable",
    "Param",
    "PoseAngles",
    "Projection",
    "angle_limit",
    "ideal_angle",
    "ideal_radius",
    "inverse_table",
    "local_stretch",
    "pose_angles",
    "project",
    "project_fast",
    "project_with_jacobian",
    "project_with_rows_fast",
    "rising_limit",
    "rotation_from_pose_angles",
    "rotation_matrix",
    "rotation_vector",
    "unproject",
]
