"""A world that is turned with everything public in it looks the same from cameras that are turned with it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from stages.analysis.attacks.rigid_motion import rigid_motion
from stages.hiding.rendering import COVER
from tests.stages.analysis.attacks.containers import MESSAGE, METHODS, shown, target_and_owner

SAME = 2e-3


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(1)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("degrees", [15.0, 90.0])
def test_the_cover_stays_and_so_does_the_message_unless_it_is_told_directions(method: str, degrees: float) -> None:
    target, owner = target_and_owner(method)
    before, attacked = shown(target, owner), rigid_motion(target, degrees, generator())
    assert (attacked.gaussians.means - target.gaussians.means).norm(dim=1).max() > 0.1
    cover = shown(attacked, attacked.method)[COVER]
    assert (cover - before[COVER]).abs().max() < SAME
    change = float((shown(attacked, owner)[MESSAGE] - before[MESSAGE]).abs().max())
    assert (change > SAME) == (method == "homogeneous")


def test_it_turns_about_the_middle_by_the_angle() -> None:
    target, _ = target_and_owner("sh")
    target = target.with_parameters({"means": target.gaussians.means + 5})
    middle = target.gaussians.means.median(dim=0).values.double().numpy()[None]
    motion = rigid_motion(target, 15.0, generator()).motion
    assert motion.points(middle) == pytest.approx(middle)
    assert np.rad2deg(Rotation.from_matrix(motion.rotation).magnitude()) == pytest.approx(15)


def test_cameras_follow_a_world_that_turns_twice() -> None:
    target, _ = target_and_owner("gs_hider")
    attacked = rigid_motion(rigid_motion(target, 40.0, generator()), 25.0, torch.Generator().manual_seed(2))
    before, after = (shown(each, each.method)[COVER] for each in (target, attacked))
    assert (after - before).abs().max() < SAME


def test_a_world_without_gaussians_turns_too() -> None:
    target, _ = target_and_owner("gs_hider", 0)
    assert len(rigid_motion(target, 15.0, generator()).gaussians) == 0
