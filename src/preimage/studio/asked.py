"""What the page may say in a request: places, frames, plans, touches. FastAPI checks it and describes it."""

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from preimage.presets import Preset, TrainOptions
from preimage.studio.goals import MOST_SEEDS
from preimage.studio.table import Touch

Share = Annotated[float, Field(ge=0, le=1)]
Seed = Annotated[int, Field(ge=0, lt=MOST_SEEDS, description="draws what lies on the table")]
MOST_UPDATES = 1_000_000
"""Months of them."""
FARTHEST = 6.0
"""How far from the middle of the plane the page may ask, in standard deviations: beyond, nothing was learned."""
MOST_PACE = 20.0
"""More is no longer seen."""


class Place(BaseModel):
    """A place on the picture of the table."""

    seen: tuple[Share, Share] = Field(description="shares of the picture's width from the left and of its height from the top")
    seed: Seed = 0


class FrameOf(BaseModel):
    """A frame of a recording."""

    data: str = Field(max_length=255, description="name of a data set that the studio was given")
    episode: Annotated[int, Field(ge=0)]
    step: Annotated[int, Field(ge=0)]


class Now(BaseModel):
    """What the camera sees: after the execution of a plan, or before anything."""

    job: str | None = Field(default=None, max_length=64)
    seed: Seed = 0


class Wanted(BaseModel):
    """What is to be planned."""

    goal: int = Field(description="number of a goal")
    preset: Preset = "full"


class Pace(BaseModel):
    """How a plan is to be executed."""

    pace: float = Field(default=1.0, ge=0.25, le=MOST_PACE, description="how many times as fast as the robot")


class Touched(BaseModel):
    """What a person does to what is on the table while the arm moves."""

    kind: Touch
    seen: tuple[Share, Share] = Field(description="where to: shares of the picture's width from the left and of its height from the top")


class Training(BaseModel):
    """A training that is to begin."""

    data: str = Field(max_length=255, description="name of a data set that the studio was given")
    name: str = Field(min_length=1, max_length=64, description="what the run is to be called")
    size: Literal["tiny", "small", "paper"] = "small"
    preset: Preset = "full"
    updates: int = Field(default=TrainOptions.updates, ge=1, le=MOST_UPDATES)


class Point(BaseModel):
    """A point of the plane of intentions, in standard deviations."""

    point: tuple[Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)], Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]]
