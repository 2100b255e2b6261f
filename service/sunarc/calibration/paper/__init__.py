"""The paper's own procedure (Urquhart et al. 2016, section 4), kept as reference and for the studies.

`dlt` the linear pose · `constraints` c1, c2, c3 · `stages` the three-stage fit.
"""

from sunarc.calibration.paper.constraints import Penalties
from sunarc.calibration.paper.dlt import direct_linear_pose
from sunarc.calibration.paper.stages import fit_as_paper

__all__ = ["Penalties", "direct_linear_pose", "fit_as_paper"]
