"""What methods, their attributes and a secret's facts may be called, where files with these names are to be read."""

from __future__ import annotations

import re

WORD = re.compile(r"[a-z][a-z0-9_]{0,63}")
"""`import_container` refuses files with other names, so methods with other names are not trained."""
