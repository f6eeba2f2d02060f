from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings

from stages.scene.alignment import (
    best,
    cameras_in_message_world,
    candidates,
    cells_filled,
    familiar_turns,
    focus_point,
    placement,
    project,
    rig_of,
    scales,
    unit,
)
from stages.scene.cameras import Cameras
from stages.scene.pose_errors import pose_errors
from stages.scene.similarity import Similarity
from tests.stages.scene.rigs import arc, moved, similarities

TARGET = np.array([3.0, -1.0, 0.5])
NO_POINTS = np.empty((0, 3))


def cloud(target: np.ndarray, spread: float = 1.5, count: int = 3000) -> np.ndarray:
    return target + np.random.default_rng(3).normal(size=(count, 3)) * spread


@pytest.mark.parametrize("degrees", [360.0, 120.0, 60.0])
def test_a_rig_is_summed_up(degrees: float) -> None:
    rig = rig_of(arc(TARGET, degrees=degrees), cloud(TARGET))
    np.testing.assert_allclose(rig.focus, TARGET, atol=0.1)
    np.testing.assert_allclose(rig.up, [0, 0, 1], atol=0.02)
    assert rig.distance == pytest.approx(np.hypot(4.0, 1.5), rel=0.05)
    assert rig.elevation == pytest.approx(np.arctan2(1.5, 4.0), abs=0.02)
    np.testing.assert_allclose(rig.half_extent, rig.distance * np.array([48, 36]) / 90)
    if degrees < 360:
        np.testing.assert_allclose(rig.forward, [-1, 0, 0], atol=0.02)


def test_parallel_axes_look_as_far_as_the_points_are() -> None:
    one = arc(TARGET, views=1)
    poses = np.repeat(one.world_to_camera, 5, axis=0)
    poses[:, 0, 3] += np.linspace(-1, 1, 5)  # side by side, all looking the same way
    row = Cameras(tuple("abcde"), poses, np.repeat(one.intrinsics, 5, axis=0), one.width, one.height)
    np.testing.assert_allclose(focus_point(row, cloud(TARGET, 0.2)), TARGET, atol=0.1)


@settings(max_examples=25, deadline=None)
@given(similarities())
def test_a_rig_is_carried_along_with_its_world(similarity: Similarity) -> None:
    cameras, points = arc(TARGET, degrees=90), cloud(TARGET)
    rig, carried = rig_of(cameras, points), rig_of(moved(cameras, similarity), similarity.points(points))
    np.testing.assert_allclose(carried.focus, similarity.points(rig.focus[None])[0], atol=1e-6 * similarity.scale)
    np.testing.assert_allclose(carried.axes(), similarity.rotation @ rig.axes(), atol=1e-6)
    assert carried.distance == pytest.approx(similarity.scale * rig.distance, rel=1e-6)


@settings(max_examples=25, deadline=None)
@given(similarities())
def test_a_message_from_the_same_rig_comes_to_lie_on_it(similarity: Similarity) -> None:
    """The plain match, always the first candidate, undoes whatever separates the two worlds."""
    cover, points = arc(TARGET, degrees=120), cloud(TARGET)
    message = moved(cover, similarity)
    plain = candidates(cover, message, similarity.points(points), cover_points=points)[0]
    placed = moved(message, plain)
    np.testing.assert_allclose(placed.centres(), cover.centres(), atol=1e-5)
    np.testing.assert_allclose(placed.world_to_camera, cover.world_to_camera, atol=1e-5)
    assert pose_errors(placed, cover).position.max() < 1e-6


RIGS = {
    "orbit": arc(np.zeros(3), views=24),
    "frontal arc, upright": arc(TARGET, views=20, degrees=60, radius=2.5, height=0.2, size=(54, 96), focal=80),
    "partial orbit": arc(-TARGET, views=15, degrees=200, radius=1.2, height=0.9, focal=100),
}


@pytest.mark.parametrize("message", RIGS)
@pytest.mark.parametrize("cover", RIGS)
def test_the_best_candidate_fills_every_view(cover: str, message: str) -> None:
    target = rig_of(RIGS[message], NO_POINTS).focus
    points = cloud(target, spread=0.8 * rig_of(RIGS[message], NO_POINTS).distance, count=6000)
    choices = candidates(RIGS[cover], RIGS[message], points)
    assert 1 <= len(choices) <= 24
    chosen = best(choices, lambda each: cells_filled(RIGS[cover], each.points(points)))
    assert cells_filled(RIGS[cover], chosen.points(points)) > 0.95


def test_at_each_scale_the_turns_that_fill_most_are_tried() -> None:
    cover, message = arc(np.zeros(3), views=12, degrees=90), RIGS["orbit"]
    points = cloud(np.zeros(3), count=1000) * [1.0, 0.2, 0.2]
    rigs = rig_of(cover, NO_POINTS), rig_of(message, points)
    choices = candidates(cover, message, points)
    for scale in scales(*rigs)[1:]:  # the plain match has the first
        tried = [cells_filled(cover, each.points(points)) for each in choices if each.scale == scale]
        turns = familiar_turns(cover, message, *rigs)
        every = [cells_filled(cover, placement(*rigs, scale, *turn).points(points)) for turn in turns]
        assert tried == sorted(every, reverse=True)[: len(tried)]
        assert min(every) < max(every)


def test_a_frontal_message_is_seen_from_its_front() -> None:
    """Nothing was photographed from behind a frontal capture, so no candidate may look from there."""
    message = RIGS["frontal arc, upright"]
    cover = arc(np.zeros(3), views=9, degrees=50)
    rig = rig_of(message, NO_POINTS)
    for each in candidates(cover, message, cloud(rig.focus)):
        views = cameras_in_message_world(cover, each).world_to_camera[:, 2, :3]
        assert (views @ rig.forward).min() > np.cos(np.radians(70))


def test_no_candidate_drives_the_cameras_into_the_message() -> None:
    upright, flat = RIGS["frontal arc, upright"], RIGS["partial orbit"]
    cover, message = rig_of(upright, NO_POINTS), rig_of(flat, NO_POINTS)
    for scale in scales(cover, message):
        assert cover.distance / scale >= 0.6 * message.distance - 1e-9


def test_points_where_they_are_seen() -> None:
    cover, message = RIGS["orbit"], RIGS["partial orbit"]
    points = cloud(rig_of(message, NO_POINTS).focus, 0.3)
    placed = candidates(cover, message, points)[0]
    in_cover, depth = project(cover, placed.points(points))
    in_message, message_depth = project(cameras_in_message_world(cover, placed), points)
    np.testing.assert_allclose(in_message, in_cover, atol=1e-6)
    np.testing.assert_allclose(message_depth * placed.scale, depth, rtol=1e-9)


def test_the_first_of_equal_candidates_is_chosen() -> None:
    choices = [Similarity(scale, np.eye(3), np.zeros(3)) for scale in (1.0, 2.0, 3.0)]
    assert best(choices, lambda each: each.scale >= 2) is choices[1]
    with pytest.raises(ValueError, match="no similarities"):
        best([], lambda each: 0)


def test_rigs_without_cameras_are_refused() -> None:
    empty = Cameras((), np.empty((0, 4, 4)), np.empty((0, 3, 3)), 8, 8)
    with pytest.raises(ValueError, match="without cameras"):
        candidates(RIGS["orbit"], empty, NO_POINTS)


def test_a_message_without_points_is_placed_all_the_same() -> None:
    assert candidates(RIGS["orbit"], RIGS["partial orbit"], NO_POINTS)


def test_a_message_photographed_from_higher_up_is_tilted_until_it_is_seen_so() -> None:
    """The message's mean view is turned onto the cover's; the other sign would tilt it away by twice as much."""
    cover, message = (arc(np.zeros(3), views=9, degrees=40, height=height) for height in (0.5, 3.0))
    cover_rig, message_rig = rig_of(cover, NO_POINTS), rig_of(message, NO_POINTS)
    tilt = cover_rig.elevation - message_rig.elevation
    assert any(found == pytest.approx(tilt) for found, _ in familiar_turns(cover, message, cover_rig, message_rig))
    placed = placement(cover_rig, message_rig, 1.0, tilt, 0.0)
    looking, wanted = (unit(cameras.world_to_camera[:, 2, :3].mean(axis=0)) for cameras in (message, cover))
    np.testing.assert_allclose(placed.rotation @ looking, wanted, atol=0.02)
