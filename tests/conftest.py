"""Hypothesis draws the same examples on every run: what is green stays green until the code changes.

To search for new ones: `pytest --hypothesis-profile=search tests/opencl/test_poison.py`.
"""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("repeatable", derandomize=True)
settings.register_profile("search", derandomize=False)
settings.load_profile("repeatable")
