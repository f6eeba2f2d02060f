"""The check of arrays tells a wrong shape, type or size of a dimension, whatever holds the array."""

from __future__ import annotations

from collections.abc import Mapping

import jaxtyping
import numpy as np
import pytest
from jaxtyping import Float32, jaxtyped

from stages.hiding.columns import columns_of
from tests.array_types import arrays_are_checked, arrays_checked

Rows = Float32[np.ndarray, "N 3"]


@jaxtyped(typechecker=arrays_checked)
def first(
    rows: Rows | None, weights: tuple[Float32[np.ndarray, " N"], ...] = (), *others: Rows, **named: Mapping[str, Rows]
) -> Float32[np.ndarray, " 3"]:
    return np.float32([1, 2, 3]) if rows is None else rows.sum(axis=1) if others else rows[0]


ROWS, WEIGHTS = np.zeros((4, 3), np.float32), np.zeros(4, np.float32)


def test_what_fits_passes() -> None:
    first(None)
    first(ROWS, (WEIGHTS, WEIGHTS), a={"b": ROWS})


@pytest.mark.parametrize(
    "call",
    [
        lambda: first(ROWS.astype(np.float64)),
        lambda: first(ROWS[:, :2]),
        lambda: first([[0.0, 0.0, 0.0]]),
        lambda: first(ROWS, (WEIGHTS, WEIGHTS[:3])),
        lambda: first(ROWS, (), ROWS[:2]),
        lambda: first(ROWS, a={"b": ROWS[:2]}),
        lambda: first(ROWS, (), ROWS),
    ],
    ids=["type", "shape", "no array", "in a tuple", "of several", "in a mapping", "returned"],
)
def test_what_does_not_fit_is_told(call: object) -> None:
    with pytest.raises(jaxtyping.TypeCheckError):
        call()


@pytest.mark.skipif(not arrays_are_checked(), reason="arrays are checked with CHECK_ARRAYS=1 only")
def test_the_projects_functions_are_checked() -> None:
    with pytest.raises(jaxtyping.TypeCheckError):
        columns_of({"raw_features": np.zeros((1, 2))})
