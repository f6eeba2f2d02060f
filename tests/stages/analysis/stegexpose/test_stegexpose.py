"""StegExpose's detectors agree with the original's figures, and with the definitions on all kinds of small pictures."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stages.analysis.stegexpose.chi_square import chi_square
from stages.analysis.stegexpose.fusion import DETECTORS, FUSION, fused, stegexpose
from stages.analysis.stegexpose.primary_sets import primary_sets
from stages.analysis.stegexpose.quadratics import real_roots
from stages.analysis.stegexpose.rs_analysis import rs_analysis
from stages.analysis.stegexpose.sample_pairs import sample_pairs
from stages.imaging.pictures import read_picture
from tests.stages.analysis.stegexpose import literal

REAL = Path(__file__).parents[5] / "shared" / "data" / "stegexpose"
COLUMNS = {
    "primary_sets": "Primary Sets",
    "chi_square": "Chi Square",
    "sample_pairs": "Sample Pairs",
    "rs_analysis": "RS analysis",
    FUSION: "Fusion (mean)",
}
ABSENT = ("null", "NaN")


@pytest.mark.skipif(not REAL.is_dir(), reason="StegExpose's test pictures are not at hand")
def test_the_figures_are_the_originals() -> None:
    with (REAL / "expected.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 7
    for row in rows:
        found = stegexpose(read_picture(REAL / row["File name"]))
        for name, column in COLUMNS.items():
            expected = math.nan if row[column] in ABSENT else float(row[column])
            assert found[name] == pytest.approx(expected, abs=1e-9, nan_ok=True), (row["File name"], name)


@st.composite
def pictures(draw: st.DrawFn) -> np.ndarray:
    """Pictures of any small size: noise of one, few or all values, slopes with or without noise in the lowest bit."""
    height, width = draw(st.integers(1, 9)), draw(st.integers(1, 9))
    generator = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    low = draw(st.integers(0, 255))
    high = draw(st.integers(low, 255))
    noise = generator.integers(low, high + 1, (height, width, 3))
    slope = (np.add.outer(np.arange(height), 3 * np.arange(width)) % 256)[..., None]
    return {"noise": noise, "slope": slope ^ (noise & 1), "smooth": slope + 0 * noise}[
        draw(st.sampled_from(["noise", "slope", "smooth"]))
    ].astype(np.uint8)


@pytest.mark.parametrize("name", ["primary_sets", "sample_pairs", "rs_analysis"])
@settings(max_examples=150, deadline=None)
@given(picture=pictures())
def test_small_pictures_give_what_the_definition_says(name: str, picture: np.ndarray) -> None:
    expected = getattr(literal, name)(picture)
    assert DETECTORS[name](picture) == pytest.approx(expected, rel=1e-9, abs=1e-12, nan_ok=True)


@settings(max_examples=15, deadline=None)
@given(size=st.tuples(st.integers(20, 34), st.integers(20, 34)), low=st.integers(0, 200), seed=st.integers(0, 99))
def test_the_histogram_grows_as_the_definition_says(size: tuple[int, int], low: int, seed: int) -> None:
    picture = np.random.default_rng(seed).integers(low, 256, (*size, 3)).astype(np.uint8)
    assert chi_square(picture) == pytest.approx(literal.chi_square(picture), rel=1e-9, abs=1e-300, nan_ok=True)


def test_what_has_no_value_is_left_out() -> None:
    flat = np.full((32, 32, 3), 7, np.uint8)
    assert primary_sets(flat) == sample_pairs(flat) == rs_analysis(flat) == 0
    odd = np.random.default_rng(0).integers(0, 256, (31, 32, 3)).astype(np.uint8)
    found = stegexpose(odd)
    assert math.isnan(found.pop("sample_pairs"))
    given_values = [value for name, value in found.items() if name != FUSION and not math.isnan(value)]
    assert found[FUSION] == pytest.approx(sum(given_values) / len(given_values))
    assert math.isnan(sample_pairs(odd.transpose(1, 0, 2)))
    point = np.zeros((1, 1, 3), np.uint8)
    assert all(math.isnan(value) for value in stegexpose(point).values())
    assert math.isnan(fused({}))


@pytest.mark.filterwarnings("error")
@settings(max_examples=60, deadline=None)
@given(picture=pictures())
def test_values_are_shares_and_nothing_is_said_aloud(picture: np.ndarray) -> None:
    before = picture.copy()
    for value in stegexpose(picture).values():
        assert math.isnan(value) or 0 <= value <= 1
    np.testing.assert_array_equal(picture, before)
    turned = np.ascontiguousarray(picture.transpose(1, 0, 2)).transpose(1, 0, 2)
    assert stegexpose(turned) == pytest.approx(stegexpose(picture), nan_ok=True)


def test_a_message_in_the_lowest_bits_is_found() -> None:
    """A photo-like picture, without and with random lowest bits, which are the longest possible message."""
    generator = np.random.default_rng(0)
    rows, columns = np.mgrid[0:256, 0:256]
    smooth = 120 + 60 * np.sin(rows / 17) + 50 * np.cos(columns / 23)
    clean = (smooth[..., None] + generator.normal(0, 2, (256, 256, 3))).clip(0, 255).astype(np.uint8)
    stego = (clean & 0xFE) | generator.integers(0, 2, clean.shape).astype(np.uint8)
    assert rs_analysis(clean) < 0.05
    assert rs_analysis(stego) > 0.95
    assert stegexpose(stego)[FUSION] > stegexpose(clean)[FUSION] + 0.3


def test_roots() -> None:
    assert real_roots(1, -3, 2) == (2, 1)
    assert real_roots(1, 0, 1) is None
    assert all(math.isnan(root) for root in real_roots(0, 2, 1) or ())
