"""The verdicts of `recover` on a container that was found: names of the rows of its figures that state them."""

from __future__ import annotations

IS_YOURS, MAY_BE_YOURS = "is_yours", "may_be_yours"
