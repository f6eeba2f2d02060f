"""Valid names of messages and hidden images: those that pages, videos and methods use otherwise are taken.

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
"""The name of a curve that every training has beside those of its pictures."""
TAKEN = (COVER, FEATURE_MAP, SIDE_BY_SIDE, LOSS)


def is_taken(name: str) -> bool:
    """Whether something other than a message has this name, regardless of case, spacing and underscores."""
    return " ".join(name.casefold().replace("_", " ").split()) in TAKEN


def _free(name: str) -> str:
    if is_taken(name):
        raise ValueError(f"{name!r} is what something else is called; give the message another name than {TAKEN}")
    if not can_be_written(name):
        raise ValueError("a message's name has control characters, which tables and bundles cannot hold")
    return name


MessageName = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME), AfterValidator(_free)]
