"""What is answered about composites."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field

from sunarc.api.schemas.parameters import AnsweringId, Next
from sunarc.json_fields import Time


class Composite(BaseModel):
    """One cycle's composite."""

    time: Annotated[Time, Field(description="Of its first exposure; names it in /v1/images/{time}.")]
    calibration: AnsweringId
    bytes: int = Field(description="Size of the 16 bit PNG, bytes.", examples=[5_200_000])


class Images(BaseModel):
    """Composites, the newest first."""

    images: list[Composite] = Field(description="The page.")
    next: Next
