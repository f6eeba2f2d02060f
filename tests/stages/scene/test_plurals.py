"""Words that agree with a number."""

from __future__ import annotations

import pytest

from stages.scene.plurals import agreeing, counted

TEXT = "photo[s] [was|were] left out ([it|they], |)"


@pytest.mark.parametrize(
    ("count", "expected"),
    [
        (0, "photos were left out (they, |)"),
        (1, "photo was left out (it, |)"),
        (2, "photos were left out (they, |)"),
    ],
)
def test_words_go_with_their_number(count: int, expected: str) -> None:
    assert agreeing(count, TEXT) == expected


def test_things_are_counted() -> None:
    assert [counted(count, "other folder") for count in range(3)] == [
        "0 other folders",
        "1 other folder",
        "2 other folders",
    ]
