"""Small artifacts for tests of stages: a scene of eight pictures, a message's views from its cameras, splats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from pipeline.artifact import Artifact, create, load
from stages.hiding.method import build_method
from stages.hiding.rendering import COVER
from stages.hiding.storage import write_container
from stages.scene.cameras import Cameras
from stages.scene.gaussians import gaussians_at
from stages.scene.message_views import MessageViews, write_message_views
from stages.scene.scene import Scene, write_scene
from stages.tracing.rig import orbit

WIDTH, HEIGHT = 32, 24
VIEWS = 8
NAMES = tuple(f"{view:03d}.png" for view in range(VIEWS))


def pictures(seed: int) -> np.ndarray:
    """A picture for each view: a gradient from black to a colour, with noise."""
    generator = np.random.default_rng(seed)
    slope = np.linspace(0, 1, WIDTH)[None, None, :, None]
    shades = slope * generator.uniform(0, 200, (VIEWS, 1, 1, 3)) + generator.uniform(0, 56, (VIEWS, HEIGHT, WIDTH, 3))
    return shades.astype(np.uint8)


def points() -> np.ndarray:
    return np.random.default_rng(1).uniform(-1, 1, (60, 3)).astype(np.float32)


def scene(folder: Path, test_views: int = 1, private: bool = False) -> Artifact:
    """A scene whose first views are the test views."""
    poses, intrinsics = orbit(VIEWS, WIDTH, HEIGHT, seed=1)
    cameras = Cameras(NAMES, poses, intrinsics, WIDTH, HEIGHT)
    colors = np.full((60, 3), 128, np.uint8)
    with create(folder, "scene", private) as writer:
        write_scene(writer, Scene(cameras, pictures(0), points(), colors, NAMES[:test_views]))
    return load(folder)


def message_views(folder: Path, name: str = "statue") -> Artifact:
    coverage = np.ones((VIEWS, HEIGHT, WIDTH), np.float32)
    colors = np.full((60, 3), 200, np.uint8)
    with create(folder, "views", private=True) as writer:
        write_message_views(writer, MessageViews(name, NAMES, pictures(1), points() / 2, colors, coverage))
    return load(folder)


def splats(folder: Path, kind: str = "splats", private: bool = False) -> Artifact:
    torch.manual_seed(0)
    method = build_method("plain", {"sh_degree": 0})
    attributes = method.initial_attributes({COVER: np.full((60, 3), 0.7)}, np.random.default_rng(0))
    with create(folder, kind, private) as writer:
        write_container(writer, gaussians_at(points(), attributes), method)
    return load(folder)
