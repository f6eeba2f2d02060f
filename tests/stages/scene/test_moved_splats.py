"""Splats that are carried elsewhere look the same to cameras that are carried along, their colours included."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stages.hiding.method import build_method
from stages.hiding.rendering import COVER
from stages.scene.cameras import single_cameras
from stages.scene.gaussians import Gaussians, gaussians_at
from stages.scene.moved_splats import MIRROR, degree_of, joined, mirrored, moved, turned_harmonics
from stages.scene.similarity import Similarity
from stages.scene.spherical_harmonics import harmonics, harmonics_count
from tests.stages.scene.rigs import arc, similarities

seeds = st.integers(0, 2**32 - 1)


def coloured(count: int, degree: int, seed: int) -> Gaussians:
    """Long Gaussians in random orientations whose colours depend strongly on the viewing direction."""
    generator = torch.Generator().manual_seed(seed)
    points = np.random.default_rng(seed).uniform(-1, 1, (count, 3))
    gaussians = gaussians_at(points, {"sh_base": torch.randn(count, 3, generator=generator)})
    gaussians.parameters["quats"] = torch.randn(count, 4, generator=generator)
    gaussians.parameters["log_scales"] = torch.randn(count, 3, generator=generator) * 0.5 - 2
    gaussians.parameters["logit_opacities"] = torch.randn(count, generator=generator)
    gaussians.parameters["sh_rest"] = torch.randn(count, harmonics_count(degree) - 1, 3, generator=generator) * 0.2
    return gaussians


@settings(max_examples=40, deadline=None)
@given(seeds, st.integers(0, 3))
def test_turned_colours_are_those_of_turned_directions(seed: int, degree: int) -> None:
    random = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=random).as_matrix()
    rest = torch.from_numpy(random.normal(size=(5, harmonics_count(degree) - 1, 3)))
    directions = torch.nn.functional.normalize(torch.from_numpy(random.normal(size=(50, 3))), dim=1)
    before = torch.einsum("dk,nkc->ndc", harmonics(directions, degree)[:, 1:], rest)
    there = directions @ torch.from_numpy(rotation).T
    after = torch.einsum("dk,nkc->ndc", harmonics(there, degree)[:, 1:], turned_harmonics(rest, rotation))
    torch.testing.assert_close(after, before, atol=1e-12, rtol=0)


def test_no_turn_and_turns_after_each_other() -> None:
    rest = torch.from_numpy(np.random.default_rng(0).normal(size=(4, 15, 3)))
    first, second = (Rotation.random(random_state=seed).as_matrix() for seed in (1, 2))
    torch.testing.assert_close(turned_harmonics(rest, np.eye(3)), rest, atol=1e-13, rtol=0)
    twice = turned_harmonics(turned_harmonics(rest, first), second)
    torch.testing.assert_close(twice, turned_harmonics(rest, second @ first), atol=1e-12, rtol=0)


@pytest.mark.parametrize("degree", [0, 3])
def test_mirrored_cameras_see_mirror_images(degree: int) -> None:
    gaussians = coloured(30, degree, seed=degree)
    plain = build_method("plain", {"sh_degree": degree})
    cameras = arc(np.zeros(3), views=3, size=(32, 24), focal=30.0)
    turn = np.eye(4)
    turn[:3, :3] = MIRROR
    there = replace(cameras, world_to_camera=turn @ cameras.world_to_camera @ turn)
    image = mirrored(gaussians)
    for here, other in zip(single_cameras(cameras), single_cameras(there), strict=True):
        before, after = (plain.render(*each).pictures[COVER] for each in ((gaussians, here), (image, other)))
        assert before.std() > 0.05
        torch.testing.assert_close(after.flip(1), before, atol=2e-4, rtol=0)
    again = mirrored(image)
    assert all(torch.equal(again[name], gaussians[name]) for name in ("means", "quats", "log_scales"))


@settings(max_examples=10, deadline=None)
@given(similarities(), st.integers(0, 3))
def test_the_pictures_stay_when_cameras_move_along(similarity: Similarity, degree: int) -> None:
    assume(similarity.scale >= 0.3)  # a smaller world is nearer than the near plane
    gaussians = coloured(30, degree, seed=degree)
    plain = build_method("plain", {"sh_degree": degree})
    cameras = arc(np.zeros(3), views=3, size=(32, 24), focal=30.0)
    carried = replace(cameras, world_to_camera=similarity.world_to_camera(cameras.world_to_camera))
    there = moved(gaussians, similarity)
    for here, other in zip(single_cameras(cameras), single_cameras(carried), strict=True):
        before, after = (plain.render(*each).pictures[COVER] for each in ((gaussians, here), (there, other)))
        assert before.mean() > 0.05
        assert (after - before).abs().mean() < 1e-3


def test_harmonics_of_every_picture_turn_and_what_a_method_adds_stays() -> None:
    gaussians = coloured(5, 2, seed=0)
    features = torch.randn(5, 7, generator=torch.Generator().manual_seed(0))
    two = torch.stack([gaussians["sh_rest"], 2 * gaussians["sh_rest"]], dim=1)
    similarity = Similarity(2.0, Rotation.from_rotvec([0.3, 0.4, 0.5]).as_matrix(), np.ones(3))
    there = moved(gaussians.with_parameters({"message_sh_rest": two, "raw_features": features}), similarity)
    turned = turned_harmonics(gaussians["sh_rest"], similarity.rotation)
    torch.testing.assert_close(there["sh_rest"], turned)
    torch.testing.assert_close(there["message_sh_rest"], torch.stack([turned, 2 * turned], dim=1))
    assert there["raw_features"] is features
    without = {name: values for name, values in gaussians.parameters.items() if name != "sh_rest"}
    torch.testing.assert_close(moved(Gaussians(without), similarity).means, there.means)


def test_joined_scenes_of_different_degrees() -> None:
    one, two = coloured(3, 1, seed=0), coloured(4, 3, seed=1)
    for first, second in ((one, two), (two, one)):
        both = joined(first, second)
        assert len(both) == 7
        assert degree_of(both["sh_rest"]) == 3
        torch.testing.assert_close(both.means, torch.cat([first.means, second.means]), rtol=0, atol=0)
    torch.testing.assert_close(joined(one, two)["sh_rest"][:3, :3], one["sh_rest"], rtol=0, atol=0)
    assert not joined(one, two)["sh_rest"][:3, 3:].any()


def test_a_number_of_harmonics_that_no_degree_has() -> None:
    with pytest.raises(ValueError, match="4"):
        degree_of(torch.zeros(1, 4, 3))
