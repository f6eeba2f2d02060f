"""Splats without photos are placed upright in the middle of the pictures; blurred and near Gaussians do not count."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from stages.hiding import placing_alone
from stages.hiding.method import build_method
from stages.hiding.placing_alone import (
    DISTANCES,
    TILTS,
    TURNS,
    direction_of,
    middle_and_radius,
    place_alone,
    sharp_coverage,
    ups,
    weighted_median,
)
from stages.hiding.rendering import COVER
from stages.scene.alignment import cameras_in_message_world, project
from stages.scene.cameras import Cameras
from stages.scene.gaussians import Gaussians, gaussians_at
from stages.scene.scene import Scene
from tests.stages.scene.rigs import arc

TARGET = np.array([3.0, -1.0, 0.5])


def gaussians_of(points: np.ndarray, opacity: float = 4.0) -> Gaussians:
    method = build_method("plain", {"sh_degree": 0})
    attributes = method.initial_attributes({COVER: np.full((len(points), 3), 0.7)}, np.random.default_rng(0))
    gaussians = gaussians_at(points, attributes)
    gaussians.parameters["logit_opacities"] = torch.full((len(points),), opacity)
    return gaussians


def statue(up: np.ndarray, foot: np.ndarray) -> Gaussians:
    """A column on a round floor, both of many small Gaussians."""
    random = np.random.default_rng(1)
    angle, radius = random.uniform(0, 2 * np.pi, 1000), np.sqrt(random.uniform(0, 9, 1000))
    floor = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(1000)], axis=1)
    angle = random.uniform(0, 2 * np.pi, 1000)
    column = np.stack([0.5 * np.cos(angle), 0.5 * np.sin(angle), random.uniform(0, 2, 1000)], axis=1)
    turn = Rotation.align_vectors(up[None], [[0.0, 0.0, 1.0]])[0].as_matrix()
    return gaussians_of(7 * np.concatenate([floor, column]) @ turn.T + foot)


def scene_of(cameras: Cameras) -> Scene:
    pictures = np.zeros((len(cameras), cameras.height, cameras.width, 3), np.uint8)
    return Scene(cameras, pictures, np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8), cameras.names[:1])


@pytest.mark.parametrize(("axis", "given"), [("-y", "auto"), ("z", "z")])
def test_a_statue_stands_upright_where_the_cover_looks(axis: str, given: str) -> None:
    upwards, foot = direction_of(axis), np.array([40.0, -20.0, 5.0])
    cover = arc(TARGET, views=3, height=1.0)
    cover = Cameras(cover.names, tilted(cover.world_to_camera), cover.intrinsics, cover.width, cover.height)
    done: list[tuple[int, int]] = []
    placed = place_alone(statue(upwards, foot), scene_of(cover), given, 16, lambda *step: done.append(step))
    ends = np.stack([foot, foot + 14 * upwards])
    pixels, depth = project(cover, placed.points(ends))
    assert (depth > 0).all()
    assert (pixels[:, 0, 1] - pixels[:, 1, 1] > 5).all(), "the column's head is above its foot in every picture"
    assert np.abs(pixels.mean(axis=1) - [48, 36]).max() < 36
    coverage = sharp_coverage(statue(upwards, foot), cameras_in_message_world(cover, placed), 24, 0.0)
    assert coverage.min() > 0.4
    assert done[-1][0] == done[-1][1] == len(done)
    assert len(done) % TURNS == 0


def tilted(poses: np.ndarray) -> np.ndarray:
    """The same poses in a tilted world, so that the cover's up is not an axis."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0.6, 0.3, 0.0]).as_matrix()
    return poses @ turn


def test_the_axis_that_is_up_in_the_cover_is_tried_where_it_is_a_convention() -> None:
    slightly = np.array([0.1, 0.1, 1.0]) / np.linalg.norm([0.1, 0.1, 1.0])
    assert [up.tolist() for up in ups("auto", slightly)] == [[0, -1, 0], [0, 0, 1]]
    assert [up.tolist() for up in ups("auto", np.array([0, -1.0, 0]))] == [[0, -1, 0]]
    assert [up.tolist() for up in ups("auto", np.array([0, 0.6, 0.8]))] == [[0, -1, 0]]
    assert [up.tolist() for up in ups("-x", slightly)] == [[-1, 0, 0]]


def test_stray_and_faint_gaussians_move_nothing() -> None:
    thing = np.random.default_rng(0).normal([10.0, 0, 0], size=(500, 3))
    far = np.random.default_rng(1).uniform(-1000, 1000, (20, 3))
    gaussians = gaussians_of(np.concatenate([thing, far]))
    gaussians.parameters["log_scales"] = torch.full((520, 3), -3.0)
    middle, radius = middle_and_radius(gaussians)
    np.testing.assert_allclose(middle, [10, 0, 0], atol=0.3)
    assert 1 < radius < 2
    faint = gaussians_of(np.concatenate([thing, thing + 1000.0]))
    faint.parameters["logit_opacities"][500:] = -9.0
    np.testing.assert_allclose(middle_and_radius(faint)[0], [10, 0, 0], atol=0.3)
    lone, width = middle_and_radius(gaussians_of(np.array([[1.0, 2.0, 3.0]])))
    assert (lone.tolist(), width) == ([1, 2, 3], 1)


def test_weighted_median() -> None:
    assert weighted_median(np.array([3.0, 1.0, 2.0]), np.array([1.0, 1.0, 1.0])) == 2
    assert weighted_median(np.array([3.0, 1.0, 2.0]), np.array([5.0, 1.0, 1.0])) == 3


def test_blurred_and_near_gaussians_count_nothing_but_hide() -> None:
    pose, intrinsics = np.eye(4)[None], np.array([[[30.0, 0, 16], [0, 30, 12], [0, 0, 1]]])
    camera = Cameras(("0",), pose, intrinsics, 32, 24)
    across, down = np.meshgrid(np.linspace(-6, 6, 60), np.linspace(-6, 6, 60))
    wall = np.stack([across.ravel(), down.ravel(), np.full(across.size, 5.0)], axis=1)
    gaussians = gaussians_of(wall)
    assert float(sharp_coverage(gaussians, camera, 32, 1.0)[0]) > 0.95
    assert float(sharp_coverage(gaussians, camera, 32, 6.0)[0]) == 0
    both = gaussians_of(np.concatenate([wall, [[0.0, 0.0, 3.0]]]), opacity=9.0)
    both.parameters["log_scales"][-1] = 2.0
    assert float(sharp_coverage(both, camera, 32, 1.0)[0]) < 0.1


def test_among_equals_the_farthest_and_most_level_wins(monkeypatch: pytest.MonkeyPatch) -> None:
    """No candidate looks less steeply than the cover does, and what counts as fog grows with the splats."""
    cover, own = arc(TARGET, views=5, degrees=30.0, height=1.0), np.degrees(np.arctan2(1.0, 4.0))
    places: list[np.ndarray] = []
    fog = set()

    def alike(gaussians: Gaussians, cameras: Cameras, width: int, clear_from: float) -> np.ndarray:
        fog.add(clear_from)
        places.append(cameras.centres())
        return np.ones(len(cameras), np.float32)

    def steepness(away: np.ndarray) -> float:
        return float(np.degrees(np.arcsin(away[:, 2] / np.linalg.norm(away, axis=1))).mean() - own)

    monkeypatch.setattr(placing_alone, "sharp_coverage", alike)
    splats = statue(direction_of("z"), np.zeros(3))
    middle, radius = middle_and_radius(splats)
    placed = place_alone(splats, scene_of(cover), "z", 16, lambda *_: None)
    away = cameras_in_message_world(cover, placed).centres() - middle
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), max(DISTANCES) * radius, rtol=0.02)
    assert steepness(away) == pytest.approx(0, abs=3)
    assert {10 * round(steepness(centres - middle) / 10) for centres in places} == set(TILTS)
    larger = splats.with_parameters({"means": 10 * splats.means})
    place_alone(larger, scene_of(cover), "z", 16, lambda *_: None)
    assert max(fog) == pytest.approx(10 * min(fog), rel=0.01)


def test_broad_gaussians_outweigh_many_tiny_ones() -> None:
    """A Gaussian is as visible as it is opaque and broad; how thin it is does not matter."""
    broad = np.random.default_rng(0).normal([10.0, 0, 0], 0.1, size=(100, 3))
    tiny = np.random.default_rng(1).normal([0.0, 0, 0], 0.1, size=(150, 3))
    gaussians = gaussians_of(np.concatenate([broad, tiny]))
    scales = torch.cat([torch.tensor([[1.0, 1e-4, 1.0]]).expand(100, 3), torch.full((150, 3), 0.1)])
    gaussians.parameters["log_scales"] = scales.log()
    np.testing.assert_allclose(middle_and_radius(gaussians)[0], [10, 0, 0], atol=0.2)
