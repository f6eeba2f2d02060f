"""Features of a found container whose columns may have been renamed by whoever took it."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Mapping

import numpy as np

from stages.hiding.columns import FIRST, LAST, NORMALS, layout_of

NUMBERED = re.compile("(.*?)([0-9]{1,6})")
OF_3DGS = [*NORMALS, *(name for attribute in (*FIRST, *LAST) for name in layout_of(attribute).names.split())]
KNOWN = re.compile("|".join(name.replace("*", "[0-9]+") for name in OF_3DGS))
"""Columns of 3DGS's splats, whether or not the published container has them."""


def unknown_columns(types: Mapping[str, np.dtype], published: Collection[str]) -> list[str]:
    """Floating-point columns that neither the published container nor 3DGS's splats have."""
    return [
        name
        for name, dtype in types.items()
        if dtype.kind == "f" and name not in published and not KNOWN.fullmatch(name)
    ]


def renamed_features(unknown: Collection[str], channels: int) -> list[str]:
    """The group of columns whose names differ only in a final number, in the order of these numbers.

    Empty unless exactly one group has as many columns as there are feature channels.
    """
    lots: dict[str, dict[int, str]] = defaultdict(dict)
    for name in unknown:
        if numbered := NUMBERED.fullmatch(name):
            lots[numbered[1]][int(numbered[2])] = name
    fitting = [lot for lot in lots.values() if len(lot) == channels]
    return [fitting[0][number] for number in sorted(fitting[0])] if len(fitting) == 1 else []
