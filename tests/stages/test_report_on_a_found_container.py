"""The report on a found container: whose it is stands at the top of the owner's page, not on the public page."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.artifact import Artifact, create, load
from pipeline.errors import UserError
from stages.analysis.measurements import Measurement, write_measurements
from stages.analysis.verdicts import IS_YOURS, MAY_BE_YOURS
from tests.stages.test_report import PUBLIC_ROWS, metrics, pages, text_of, top_of


def recovered(path: Path, verdict: str, **others: float) -> dict[str, tuple[Artifact, ...]]:
    """Figures as the stage `recover` writes them for a container that was turned and pruned."""
    figures = {
        verdict: 1.0,
        "mirrored": 0.0,
        "degrees": 12.04,
        "shift": 3.5,
        "scale": 1.0,
        "matched": 0.998,
        "found_again": 0.981,
        "feature_change": 0.0,
        "gaussians_found": 18_700.0,
        "gaussians_published": 19_000.0,
        **others,
    }
    with create(path, "measurements") as writer:
        write_measurements(writer, [Measurement(name, value, "as_found") for name, value in figures.items()])
    return {"figures": (load(path),)}


@pytest.mark.parametrize(
    ("verdict", "others", "said"),
    [
        (
            IS_YOURS,
            {},
            "This is your container: it has 98.1 % of the Gaussians you published, and they are 99.8 % of its own. "
            "It was turned by 12.0 degrees, moved by 3.5.",
        ),
        (
            IS_YOURS,
            {"degrees": 0, "shift": 0, "feature_change": 0.2},
            "of its own. It lies where you left it, and its features were changed. Another container that you made",
        ),
        (
            IS_YOURS,
            {"mirrored": 1, "degrees": 0},
            "of its own. It was mirrored, moved by 3.5.",
        ),
        (
            MAY_BE_YOURS,
            {"matched": 0.031, "found_again": 0.042, "scale": 2.5},
            "This may be your container, a part of it, or one made from the same photos: 3.1 % of its Gaussians "
            "lie where 4.2 % of those you published lie. It was turned by 12.0 degrees, moved by 3.5, scaled by 2.5.",
        ),
    ],
)
def test_whose_a_found_container_is_stands_at_the_top(
    tmp_path: Path, verdict: str, others: dict[str, float], said: str
) -> None:
    scores = {"scores": (metrics(tmp_path / "scores", PUBLIC_ROWS, True),)}
    made = pages({**scores, **recovered(tmp_path / "figures", verdict, **others)}, tmp_path / "made")
    owner, public = text_of(made["owner"]), text_of(made["public"])
    assert said in top_of(owner)
    assert ("Perhaps yours" in owner) == (verdict == MAY_BE_YOURS)
    assert "18,700" in owner[owner.index("What was found") :]
    for told in ("container", "yours", "18,700", "What was found"):
        assert told not in public, told


def test_figures_of_another_stage_are_refused(tmp_path: Path) -> None:
    scores = {"scores": (metrics(tmp_path / "scores", PUBLIC_ROWS, True),)}
    with pytest.raises(UserError, match=r"do not say whose container it is; found psnr, .*stage that uses recover"):
        pages({**scores, **recovered(tmp_path / "figures", "psnr")}, tmp_path / "made")
