"""Rays meet shapes where the shapes' equations say; normals are the gradients of those equations."""

from __future__ import annotations

import numpy as np
import pytest

from stages.tracing.shapes import Box, Coordinates, Ellipsoid, Frame, Frustum, Shape
from stages.tracing.world import along, turned

SHAPES = {
    "box": Box((0.6, 0.4, 0.9)),
    "ball": Ellipsoid((0.7, 0.7, 0.7)),
    "ellipsoid": Ellipsoid((0.9, 0.3, 0.6)),
    "cylinder": Frustum(0.5, 0.5, 0.7),
    "cone": Frustum(0.6, 0.0, 0.8),
    "bowl": Frustum(0.2, 0.7, 0.3),
}


def excess(shape: Shape, point: np.ndarray) -> np.ndarray:
    """Negative for points [3, N] inside the shape, positive outside."""
    x, y, z = point
    if isinstance(shape, Box):
        return (np.abs(point) - np.array(shape.half)[:, None]).max(axis=0)
    if isinstance(shape, Ellipsoid):
        return (np.linalg.norm(point / np.array(shape.half)[:, None], axis=0) - 1) * min(shape.half)
    assert isinstance(shape, Frustum)
    part = (z / shape.half_height + 1) / 2
    radius = shape.bottom + (shape.top - shape.bottom) * part
    return np.maximum(np.hypot(x, y) - radius, np.abs(z) - shape.half_height)


def coordinates(array: np.ndarray) -> Coordinates:
    x, y, z = array.astype(np.float32)
    return x, y, z


def rays_at(shape: Shape, count: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Rays [3, N] from all sides, most of them towards the shape."""
    generator = np.random.default_rng(7)
    origin = generator.normal(size=(3, count))
    origin *= 3 / np.linalg.norm(origin, axis=0)
    direction = generator.uniform(-0.7, 0.7, (3, count)) - origin
    return origin, direction / np.linalg.norm(direction, axis=0)


@pytest.mark.parametrize("name", SHAPES)
def test_the_first_hit_is_where_the_ray_enters(name: str) -> None:
    shape = SHAPES[name]
    origin, direction = rays_at(shape)
    distance = shape.hit(coordinates(origin), coordinates(direction)).astype(np.float64)
    steps = np.linspace(0, 6, 3001)
    inside = np.stack([excess(shape, origin + step * direction) < -2e-3 for step in steps])
    enters = np.where(inside.any(axis=0), steps[inside.argmax(axis=0)], np.inf)
    met = np.isfinite(distance)
    assert 50 < met.sum() < 400
    # A ray that only grazes may count either way; one that enters must be hit, and exactly where it enters.
    assert met[np.isfinite(enters)].all()
    assert np.abs(excess(shape, origin[:, met] + distance[met] * direction[:, met])).max() < 2e-5
    assert (distance[met] <= enters[met]).all()


@pytest.mark.parametrize("name", SHAPES)
def test_seen_from_inside_the_far_wall_is_hit(name: str) -> None:
    shape = SHAPES[name]
    _, direction = rays_at(shape)
    origin = np.zeros((3, 1)) - [[0.0], [0.0], [0.05]]
    distance = shape.hit(coordinates(origin), coordinates(direction))
    assert np.isfinite(distance).all()
    assert np.abs(excess(shape, origin + distance * direction)).max() < 2e-5


@pytest.mark.parametrize("name", SHAPES)
def test_normals_are_gradients(name: str) -> None:
    shape = SHAPES[name]
    origin, direction = rays_at(shape)
    distance = shape.hit(coordinates(origin), coordinates(direction))
    met = np.isfinite(distance)
    point = origin[:, met] + distance[met] * direction[:, met]
    normal, u, v = shape.surface(coordinates(point))
    gradient = np.stack(
        [excess(shape, point + step) - excess(shape, point - step) for step in 1e-5 * np.eye(3)[..., None]]
    )
    gradient /= np.linalg.norm(gradient, axis=0)
    agree = (np.stack(normal) * gradient).sum(axis=0)
    # On an edge between two faces the gradient is not unique: float32 may choose the other face.
    assert (agree > 0.999).mean() > 0.98
    assert np.isfinite(u).all()
    assert np.isfinite(v).all()


def test_a_bevel_turns_the_normal_only_near_edges() -> None:
    box = Box((1.0, 1.0, 1.0), bevel=0.1)
    flat, _, _ = box.surface(coordinates(np.array([[1.0], [0.2], [0.3]])))
    edge, _, _ = box.surface(coordinates(np.array([[1.0], [0.999], [0.3]])))
    assert np.allclose(np.stack(flat).ravel(), [1, 0, 0])
    assert np.allclose(np.stack(edge).ravel(), [2**-0.5, 2**-0.5, 0], atol=0.01)


def test_a_surface_unrolls_without_stretching() -> None:
    generator = np.random.default_rng(3)
    angle, height = generator.uniform(-3, 3, 50), generator.uniform(-0.6, 0.6, 50)
    ring = np.stack([0.5 * np.cos(angle), 0.5 * np.sin(angle), height])
    _, u, v = SHAPES["cylinder"].surface(coordinates(ring))
    assert np.allclose(u, 0.5 * angle, atol=1e-5)
    assert np.allclose(v, height, atol=1e-6)


@pytest.mark.parametrize("axes", [np.eye(3), turned(30, -20, 70), turned(yaw=90), along((0.3, -0.5, 0.8))])
def test_a_frame_goes_there_and_back(axes: np.ndarray) -> None:
    frame = Frame(np.array([0.3, -1.2, 2.0]), axes)
    assert np.allclose(axes @ axes.T, np.eye(3))
    assert np.linalg.det(axes) == pytest.approx(1)
    world = np.random.default_rng(0).normal(size=(3, 20))
    local = np.stack(frame.point_to_local(coordinates(world)))
    assert np.allclose(local, axes @ (world - frame.centre[:, None]), atol=1e-5)
    back = np.stack(frame.direction_to_world(frame.direction_to_local(coordinates(world))))
    assert np.allclose(back, world, atol=1e-5)
