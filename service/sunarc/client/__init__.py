"""The service as others' Python sees it: numpy in, numpy out; imports nothing else of this package.

imager.py: what can be asked · transport.py: requests, repeated where that helps.
"""

from sunarc.client.imager import BackProjection, Imager, Located, Projection
from sunarc.client.transport import ImagerError

__all__ = ["BackProjection", "Imager", "ImagerError", "Located", "Projection"]
