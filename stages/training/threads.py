"""How many threads a stage lets torch use on the CPU."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

Threads = Annotated[int, Field(ge=1, description="PyTorch CPU threads; the result's exact bits may depend on it.")]
"""Sums of many numbers, as in losses, scores and some gradients, are added in as many parts as there are threads."""
