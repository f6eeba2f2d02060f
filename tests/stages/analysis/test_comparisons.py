"""Pictures come back beside their truth, each of its view, and what has no truth is stored once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.artifact import create, load
from stages.analysis.comparisons import Comparison, read_comparisons, write_comparisons

PICTURES = np.random.default_rng(0).integers(0, 256, (2, 3, 4, 5, 3), dtype=np.uint8)


def comparison(has_truth: bool = True) -> Comparison:
    truth = PICTURES[0] if has_truth else PICTURES[1]
    names, splits = ("a.png", "b.png", "c.png"), ("test", "train", "test")
    return Comparison("statue", "message", "gs_hider", names, splits, truth, PICTURES[1], has_truth)


def test_comparisons_come_back_as_written(tmp_path: Path) -> None:
    with create(tmp_path / "pictures", "comparisons") as writer:
        write_comparisons(writer, [comparison(), comparison(has_truth=False)])
    artifact = load(tmp_path / "pictures")
    for found, has_truth in zip(read_comparisons(artifact), (True, False), strict=True):
        expected = comparison(has_truth)
        assert str(replace(found, truth=expected.truth, rendered=expected.rendered)) == str(expected)
        assert found.of_views(["b.png"]).rendered.shape == (1, *PICTURES[1].shape[1:])
        assert found.of_views([]).truth.shape == (0, *PICTURES[1].shape[1:])
        np.testing.assert_array_equal(found.truth, PICTURES[0 if has_truth else 1])
        np.testing.assert_array_equal(found.rendered, PICTURES[1])
    stored = {path.parent.relative_to(artifact.path).as_posix() for path in artifact.path.rglob("*") if path.is_file()}
    assert any("0/truth" in folder for folder in stored)
    assert not any("1/truth" in folder for folder in stored)


def test_some_views_are_those_views_with_their_splits() -> None:
    some = comparison().of_views({"c.png", "b.png", "z.png"})
    assert (some.names, some.splits) == (("b.png", "c.png"), ("train", "test"))
    np.testing.assert_array_equal(some.truth, PICTURES[0, 1:])
    np.testing.assert_array_equal(some.rendered, PICTURES[1, 1:])
