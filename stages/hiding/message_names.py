"""What a message or an image may be called: what the pages, the videos and the methods call something else is taken.

A message called `cover` would be trained on as the cover and published as one.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from stages.hiding.rendering import COVER
from stages.imaging.names import LONGEST_NAME, can_be_written

FEATURE_MAP = "feature map"
SIDE_BY_SIDE = "side by side"
LOSS = "loss"
"""A curve of every training, beside those of its pictures."""
TAKEN = (COVER, FEATURE_MAP, SIDE_BY_SIDE, LOSS)


def is_taken(name: str) -> bool:
    """Whether a picture or a video that is no message's has this name, in whatever case and spacing."""
    return " ".join(name.casefold().replace("_", " ").split()) in TAKEN


def _free(name: str) -> str:
    if is_taken(name):
        raise ValueError(f"{name!r} is what something else is called; give the message another name than {TAKEN}")
    if not can_be_written(name):
        raise ValueError("a message's name has control characters, which tables and bundles cannot hold")
    return name


MessageName = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME), AfterValidator(_free)]
