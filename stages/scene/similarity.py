"""Similarities: a rotation, a uniform scale and a translation from one world into another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation


@dataclass(frozen=True, eq=False)
class Similarity:
    """x ↦ scale · rotation @ x + translation, from a source world into a target world.

    Compared by identity, not by value. Raises `ValueError` for wrong shapes, a scale that is not positive, a matrix
    that is not a rotation, or values that are not finite.
    """

    scale: float
    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, " 3"]

    def __post_init__(self) -> None:
        if self.rotation.shape != (3, 3) or self.translation.shape != (3,):
            raise ValueError(f"a similarity of shapes {self.rotation.shape}, {self.translation.shape}")
        if not (np.isfinite(self.scale) and self.scale > 0 and np.isfinite(self.translation).all()):
            raise ValueError(f"a similarity of scale {self.scale} and translation {self.translation}")
        orthonormal = np.allclose(self.rotation @ self.rotation.T, np.eye(3), atol=1e-6)
        if not (orthonormal and np.linalg.det(self.rotation) > 0):
            raise ValueError("a similarity's matrix is no rotation")

    @staticmethod
    def identity() -> Similarity:
        """The similarity that changes nothing."""
        return Similarity(1.0, np.eye(3), np.zeros(3))

    def points(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Points of the source world, in the target world. N = 0 is allowed."""
        return self.scale * points @ self.rotation.T + self.translation

    def directions(self, directions: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Directions, rotated without a change of length."""
        return directions @ self.rotation.T

    def world_to_camera(self, world_to_camera: Float[np.ndarray, "V 4 4"]) -> Float[np.ndarray, "V 4 4"]:
        """Poses in the target world of cameras in the source world: every picture stays the same.

        Depths are multiplied by `scale`.
        """
        moved = world_to_camera.copy()
        moved[:, :3, :3] = world_to_camera[:, :3, :3] @ self.rotation.T
        moved[:, :3, 3] = self.scale * world_to_camera[:, :3, 3] - moved[:, :3, :3] @ self.translation
        return moved

    def gaussians(
        self,
        means: Float[np.ndarray, "N 3"],
        quats: Float[np.ndarray, "N 4"],
        log_scales: Float[np.ndarray, "N 3"],
    ) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 4"], Float[np.ndarray, "N 3"]]:
        """Gaussians of the source world in the target world; quaternions are w x y z and keep their length.

        Opacities and colours stay. View-dependent colours (spherical harmonics) would have to rotate, too: move the
        cameras into the source world instead (`inverse().world_to_camera`), which gives the same picture.
        """
        turned = hamilton_product(quaternion_of(self.rotation), quats)
        return self.points(means), turned, log_scales + np.log(self.scale)

    def inverse(self) -> Similarity:
        """From the target world back into the source world."""
        return Similarity(1 / self.scale, self.rotation.T, -self.rotation.T @ self.translation / self.scale)

    def compose(self, first: Similarity) -> Similarity:
        """This similarity after `first`."""
        moved = self.points(first.translation[None])[0]
        return Similarity(self.scale * first.scale, self.rotation @ first.rotation, moved)


def quaternion_of(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, " 4"]:
    """The unit quaternion w x y z of a rotation matrix, with w ≥ 0."""
    x, y, z, w = Rotation.from_matrix(rotation).as_quat(canonical=True)
    return np.array([w, x, y, z])


def hamilton_product(left: Float[np.ndarray, " 4"], right: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, "N 4"]:
    """left · right for quaternions w x y z: rotate by `right`, then by `left`."""
    scalar = left[0] * right[:, :1] - right[:, 1:] @ left[1:, None]
    vector = left[0] * right[:, 1:] + right[:, :1] * left[1:] + np.cross(left[1:], right[:, 1:])
    return np.concatenate([scalar, vector], axis=1)


def fit_similarity(source: Float[np.ndarray, "N 3"], target: Float[np.ndarray, "N 3"]) -> Similarity:
    """The least-squares similarity from N source points to their targets (Umeyama 1991).

    Collinear points leave the rotation about their line undetermined: one of the best is returned. Raises `ValueError`
    for different shapes, fewer than three pairs, or if all sources or all targets coincide.
    """
    if source.shape != target.shape or len(source) < 3:
        raise ValueError(f"a similarity needs at least three pairs of points; got {source.shape} and {target.shape}")
    from_source, from_target = source - source.mean(axis=0), target - target.mean(axis=0)
    spread, target_spread = (from_source**2).sum(), (from_target**2).sum()
    size = np.finfo(float).eps * max((source**2).sum(), 1e-300)
    if spread <= size or target_spread <= np.finfo(float).eps * max((target**2).sum(), 1e-300):
        raise ValueError("a similarity cannot be fitted to points that all coincide")
    left, singular, right = np.linalg.svd(from_target.T @ from_source)
    mirror = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    rotation = (left * mirror) @ right
    scale = float((singular * mirror).sum() / spread)
    return Similarity(scale, rotation, target.mean(axis=0) - scale * rotation @ source.mean(axis=0))
