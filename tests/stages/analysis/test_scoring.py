"""Views that show nothing of a message have only figures of coverage for it, here as under attack."""

from __future__ import annotations

import math

import numpy as np
import pytest

from stages.analysis.attacks.scoring import Scorer
from stages.analysis.scoring import score
from stages.hiding.opening import ReadContainer
from stages.imaging.metric_table import mean_value
from stages.scene.message_views import MessageViews
from tests.stages.analysis.attacks.containers import MESSAGE, scene, target_and_owner
from tests.stages.small import HEIGHT, NAMES, VIEWS, WIDTH, pictures

BLANK = NAMES[1]


def message() -> dict[str, MessageViews]:
    """A message in half of each picture, which one view does not show at all."""
    shown, coverage = pictures(1), np.ones((VIEWS, HEIGHT, WIDTH), np.float32)
    coverage[:, :, : WIDTH // 2] = 0
    shown[NAMES.index(BLANK)], coverage[NAMES.index(BLANK)] = 0, 0
    nothing = np.zeros((0, 3), np.float32)
    return {MESSAGE: MessageViews(MESSAGE, NAMES, shown, nothing, nothing.astype(np.uint8), coverage)}


def test_a_view_that_shows_nothing_of_the_message_does_not_count_for_it() -> None:
    """A container that is black there as well would have an infinite mean PSNR."""
    target, owner = target_and_owner("sh")
    container = ReadContainer(target.gaussians, owner, target.gaussians)
    scores = score(container, "sh", scene(), message(), {}, 0, lambda done, total: None)
    rows = [row for row in scores.rows if row.message == MESSAGE]
    known = {row.quantity for row in rows if row.view == BLANK and not math.isnan(row.value)}
    assert known == {"coverage", "legal"}
    assert all(math.isfinite(row.value) for row in rows if row.view != BLANK)
    attacked = Scorer(owner, scene(), message(), NAMES[:2]).figures(target)
    for quantity in ("psnr", "ssim", "psnr_covered"):
        average = mean_value([row for row in rows if row.quantity == quantity and row.split == "test"])
        assert attacked[MESSAGE, quantity] == pytest.approx(average, abs=1e-6), quantity


def test_residuals_are_kept_for_those_who_ask_for_them() -> None:
    """They are as large as all test views in float32."""
    target, owner = target_and_owner("sh")
    container = ReadContainer(target.gaussians, owner, target.gaussians)
    for asked in (False, True):
        scores = score(container, "sh", scene(), {}, {}, 0, lambda done, total: None, keep_residuals=asked)
        assert set(scores.residuals) == (set(scene().test_names) if asked else set())
