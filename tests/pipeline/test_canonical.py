"""Equal values have one spelling, different values have different ones, and all else is refused."""

from __future__ import annotations

import json
import math
from enum import Enum

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.canonical import canonical_json, digest_of

scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
values = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3), max_leaves=8
)


@given(values)
def test_the_spelling_says_the_value(value: object) -> None:
    assert json.loads(canonical_json(value)) == value


@given(st.dictionaries(st.text(), scalars))
def test_order_does_not_matter(value: dict[str, object]) -> None:
    assert digest_of(dict(reversed(value.items()))) == digest_of(value)


@given(values, values)
def test_different_values_are_told_apart(first: object, second: object) -> None:
    same = canonical_json(first) == canonical_json(second)
    assert same == (repr_of(first) == repr_of(second))


def repr_of(value: object) -> str:
    """A spelling that tells 1, 1.0, True and -0.0 apart, which `==` does not."""
    if isinstance(value, dict):
        return "{" + ",".join(f"{name!r}:{repr_of(value[name])}" for name in sorted(value)) + "}"
    return f"[{','.join(map(repr_of, value))}]" if isinstance(value, list) else repr(value)


class Mode(Enum):
    FAST = "fast"


def test_tuples_and_enumerations() -> None:
    assert canonical_json((1, (Mode.FAST,))) == b'[1,["fast"]]'


@pytest.mark.parametrize(
    "value",
    [math.nan, -math.inf, b"", {1, 2}, {1: 2}, object(), np.float32(1), np.int64(1), np.zeros(2), [1, {"a": b""}]],
)
def test_what_cannot_be_told_apart_is_refused(value: object) -> None:
    with pytest.raises((TypeError, ValueError), match="value"):
        digest_of(value)


LOOKALIKES: list[tuple[object, object]] = [
    *((1, 1.0), (1, True), (0.0, -0.0), (0, False), (2**53, 2**53 + 1), (10**300, 1e300), (5e-324, 0.0)),
    *(("\u00e9", "e\u0301"), ("\udc80", "\\udc80"), ("1", 1), (None, "null"), ([], {}), ("", None)),
]


def test_lookalikes_are_told_apart() -> None:
    for first, second in LOOKALIKES:
        assert digest_of(first) != digest_of(second), (first, second)
        assert digest_of({"a": [first]}) != digest_of({"a": [second]}), (first, second)


def test_what_has_no_spelling_of_its_own_is_refused() -> None:
    """JSON reads two surrogates as one character, which is another text; and some numbers are too long to write."""
    for value in ("\ud83d\ude00", {"\ud83d\ude00": 1}, 10**5000, frozenset(), 1j, range(2)):
        with pytest.raises((TypeError, ValueError)):
            digest_of(value)
