"""Untrained containers of every method: small, with random attributes and decoders."""

from __future__ import annotations

import numpy as np
import torch

from stages.analysis.attacks.target import Knowledge, Target
from stages.hiding.method import Method, build_method, settings_of
from stages.hiding.rendering import COVER
from stages.scene.cameras import Cameras, rig_extent, single_cameras
from stages.scene.gaussians import gaussians_at
from stages.scene.scene import Scene
from stages.tracing.rig import orbit
from stages.training.loop import TrainingViews
from tests.stages.small import HEIGHT, NAMES, VIEWS, WIDTH, pictures

METHODS = ("sh", "decoder", "gs_hider", "homogeneous")
MESSAGE = "statue"
CHOICES = {
    "feature_dim": 16,
    "layers": 2,
    "decoder_width": 12,
    "kernel_size": 3,
    "precision": "float32",
    "sh_degree": 2,
}


def target_and_owner(name: str, count: int = 200, opacity: float = 1.0) -> tuple[Target, Method]:
    """A container without the secret, and its method with the secret. `opacity` is added to the opacities' logits."""
    settings = {setting: CHOICES[setting] for setting in settings_of(name)}
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(3)
        owner = build_method(name, settings | {"messages": [MESSAGE]})
    generator = np.random.default_rng(4)
    points = generator.uniform(-1, 1, (count, 3))
    colours = {shown: generator.uniform(0.1, 0.9, (count, 3)) for shown in (COVER, MESSAGE)}
    gaussians = gaussians_at(points, owner.initial_attributes(colours, generator))
    gaussians.parameters["logit_opacities"] += opacity + torch.linspace(0, 2, count)
    for attribute, values in gaussians.attributes.items():
        noise = 0.3 * torch.randn(values.shape, generator=torch.Generator().manual_seed(len(attribute)))
        gaussians.parameters[attribute] = values + noise
    weights = torch.Generator().manual_seed(5)
    with torch.no_grad():
        for weight in (weight for network in owner.networks.values() for weight in network.parameters()):
            weight += 0.1 * torch.randn(weight.shape, generator=weights)
    method = build_method(name, settings)
    for network, module in method.networks.items():
        module.load_state_dict(owner.networks[network].state_dict())
    for module in (*method.networks.values(), *owner.networks.values()):
        module.requires_grad_(False)
    return Target(gaussians, method), owner


def cameras() -> Cameras:
    poses, intrinsics = orbit(VIEWS, WIDTH, HEIGHT, seed=1)
    return Cameras(NAMES, poses, intrinsics, WIDTH, HEIGHT)


def scene() -> Scene:
    return Scene(cameras(), pictures(0), np.zeros((1, 3), np.float32), np.zeros((1, 3), np.uint8), NAMES[:2])


def knowledge() -> Knowledge:
    rig = cameras()
    return Knowledge(TrainingViews(single_cameras(rig), {COVER: torch.from_numpy(pictures(0))}), rig_extent(rig))


def shown(target: Target, method: Method) -> dict[str, torch.Tensor]:
    """The pictures of one view, with or without the secret; the camera moves with the world."""
    rig = cameras()
    moved = target.motion.world_to_camera(rig.world_to_camera)
    camera = single_cameras(Cameras(rig.names, moved, rig.intrinsics, WIDTH, HEIGHT))[0]
    return dict(method.render(target.gaussians, camera).pictures)
