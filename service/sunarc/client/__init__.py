"""Python client of the HTTP service on numpy alone; imports nothing else of this package.

`imager` the requests · `events` what happens · `transport` retries.
"""

from sunarc.client.events import ImagerEvent
from sunarc.client.imager import BackProjection, Condition, Finding, Imager, Located, Projection
from sunarc.client.transport import ImagerError

__all__ = ["BackProjection", "Condition", "Finding", "Imager", "ImagerError", "ImagerEvent", "Located", "Projection"]
