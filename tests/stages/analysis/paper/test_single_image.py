"""Verdicts on an image hidden in one view are as sure as the figure they are about, judged by its spread over seeds."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from stages.analysis.paper.published import read_published
from stages.analysis.paper.relations import Relation
from stages.analysis.paper.runs import Run, Study
from stages.analysis.paper.single_image import single_image
from stages.imaging.metric_table import MetricRow

THERE, ELSEWHERE, TEST = "2.png", "1.png", "0.png"


def run(seed: int, method: str, there: float, test: float, image: float) -> Run:
    """PSNR of the cover in the view that hides the image and in a test view (elsewhere 30 dB), and of the image."""
    covers = ((THERE, "train", there), (ELSEWHERE, "train", 30.0), (TEST, "test", test))
    rows = [MetricRow("psnr", value, "dB", view, split, None, None, method) for view, split, value in covers]
    rows.append(MetricRow("psnr", image, "dB", THERE, "train", "boat", None, method))
    rows.append(MetricRow("hides_image", 1.0, "", THERE, "train", "boat", None, method))
    return Run("fox", method, (), str(seed), tuple(rows))


Figures = tuple[float, float, float]


def relations(hider: Sequence[Figures], decoder: Sequence[Figures]) -> list[Relation]:
    runs = [
        run(seed, method, *figures)
        for method, every in (("gs_hider", hider), ("decoder", decoder))
        for seed, figures in enumerate(every)
    ]
    return [*single_image(Study(tuple(runs)), read_published()).relations]


def test_a_loss_at_the_view_that_hides_is_as_sure_as_that_loss_is() -> None:
    """Test views that hardly differ between seeds do not make it surer."""
    steady = [(32.0, 30.0, 44.0), (32.0, 30.01, 44.0), (32.0, 30.02, 44.0)]
    for spread, verdict in ((4.0, "holds, within noise"), (0.1, "holds")):
        shaken = [(29.5 + offset, 29.9 + offset / 1000, 34.0) for offset in (0.0, spread, -spread)]
        [overfits] = [each for each in relations(steady, shaken) if "overfits" in each.text]
        assert overfits.value == pytest.approx(-0.5)
        assert overfits.verdict == verdict


def test_how_sure_the_image_is_follows_from_the_image() -> None:
    for spread, verdict in ((3.0, "holds, within noise"), (0.1, "holds")):
        hider = [(32.0, 30.0, 41.0 + offset) for offset in (0.0, spread, -spread)]
        found = relations(hider, [(29.0, 29.0, 34.0)])
        [image] = [each for each in found if each.text == "GS-Hider: the image"]
        assert image.value == pytest.approx(41.0)
        assert image.verdict == verdict
