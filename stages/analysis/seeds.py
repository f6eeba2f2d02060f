"""Parameter type for the seeds of repeated measurements, without duplicates."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field


def _once(seeds: tuple[int, ...]) -> tuple[int, ...]:
    """The seeds. Raises `ValueError` for a duplicate, whose repeated figures would pass for independent agreement."""
    if len(set(seeds)) < len(seeds):
        raise ValueError("a seed is listed twice")
    return seeds


DistinctSeeds = Annotated[tuple[Annotated[int, Field(ge=0)], ...], AfterValidator(_once)]
"""Distinct, non-negative seeds."""
