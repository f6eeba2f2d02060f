"""What `recover` concludes of a container that was found: the row of its figures that says so is called by this."""

from __future__ import annotations

IS_YOURS, MAY_BE_YOURS = "is_yours", "may_be_yours"
