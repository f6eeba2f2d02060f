"""Regions and the frames in which they are given."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings

from stages.scene.alignment import rig_of
from stages.scene.frames import rig_frame, splats_frame
from stages.scene.regions import Region
from stages.scene.similarity import Similarity
from tests.stages.scene.rigs import arc, moved, similarities

TARGET = np.array([0.3, -0.2, 0.5])
CENTRE, SIZE = np.array([1.0, 0.0, -1.0]), np.array([2.0, 4.0, 6.0])


def test_a_box_and_an_ellipsoid_by_their_sizes_from_end_to_end() -> None:
    box, ellipsoid = (Region(shape, CENTRE, SIZE, Similarity.identity()) for shape in ("box", "ellipsoid"))
    on_axes = CENTRE + np.diag(SIZE / 2)
    assert box.contains(on_axes).all()
    assert ellipsoid.contains(on_axes).all()
    assert not box.contains(CENTRE + 1.01 * np.diag(SIZE / 2)).any()
    corner = (CENTRE + 0.99 * SIZE / 2)[None]
    assert box.contains(corner).all()
    assert not ellipsoid.contains(corner).any()
    assert box.contains(np.empty((0, 3))).shape == (0,)


@settings(max_examples=20)
@given(similarities())
def test_a_region_moves_with_its_frame(similarity: Similarity) -> None:
    points = np.random.default_rng(0).uniform(-4, 4, (200, 3))
    here = Region("ellipsoid", CENTRE, SIZE, Similarity.identity()).contains(points)
    there = Region("ellipsoid", CENTRE, SIZE, similarity).contains(similarity.points(points))
    np.testing.assert_array_equal(there, here)
    assert 0 < here.sum() < 200


def test_the_frame_of_a_rig() -> None:
    """Cameras on an arc on the side of +x, z up: forward is -x, right is +y."""
    cameras = arc(TARGET, views=9, degrees=60)
    frame = rig_frame(rig_of(cameras, np.empty((0, 3))))
    distance = np.hypot(4.0, 1.5)
    expected = TARGET + distance * np.array([[0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(
        frame.points(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])), expected, atol=0.1
    )


@settings(max_examples=20)
@given(similarities())
def test_the_frame_of_a_rig_moves_with_it(similarity: Similarity) -> None:
    cameras = arc(TARGET, views=9, degrees=60)
    points = np.random.default_rng(0).normal(size=(10, 3))
    here, there = (rig_frame(rig_of(rig, np.empty((0, 3)))) for rig in (cameras, moved(cameras, similarity)))
    np.testing.assert_allclose(there.points(points), similarity.points(here.points(points)), rtol=1e-5, atol=1e-5)


def test_the_frame_of_splats_alone() -> None:
    points = np.random.default_rng(0).normal(size=(4000, 3)) * 3 + [5, 6, 7]
    frame = splats_frame(points)
    np.testing.assert_allclose(frame.translation, [5, 6, 7], atol=0.3)
    assert (np.linalg.norm(frame.inverse().points(points), axis=1) <= 1).mean() == pytest.approx(0.9, abs=0.001)
    np.testing.assert_array_equal(frame.directions(np.array([[0.0, 0, 1]])), [[0, -1, 0]])
    assert splats_frame(points[:1]).scale == 1
    with pytest.raises(ValueError, match="no splats to find the middle"):
        splats_frame(points[:0])
