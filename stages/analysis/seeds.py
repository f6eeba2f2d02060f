"""Seeds of what is measured again and again: each once."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field


def _once(seeds: tuple[int, ...]) -> tuple[int, ...]:
    """Measured twice with one seed, figures would be taken for two that agree."""
    if len(set(seeds)) < len(seeds):
        raise ValueError("a seed is listed twice")
    return seeds


DistinctSeeds = Annotated[tuple[Annotated[int, Field(ge=0)], ...], AfterValidator(_once)]
"""Seeds of which none is negative, and none is there twice."""
