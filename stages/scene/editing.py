"""Applying edits: which Gaussians they select, and what they do to them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool
from scipy.spatial.transform import Rotation
from torch import Tensor

from pipeline.errors import UserError
from stages.scene.edits import Add, Edit, EditedRegion, Recolour, Remove
from stages.scene.frames import splats_frame
from stages.scene.gaussians import Gaussians
from stages.scene.moved_splats import joined, moved
from stages.scene.recolouring import recoloured, recolouring
from stages.scene.regions import Region
from stages.scene.similarity import Similarity
from stages.scene.spherical_harmonics import SH_BASE, SH_REST


@dataclass(frozen=True)
class Splats:
    """3DGS Gaussians and, if their cameras are known, the rig's frame; `name` is the stage input with those cameras.

    `scale` is how much larger their world is than that of the poses (`world_scale`), in which edits give coordinates.
    """

    gaussians: Gaussians
    frame: Similarity | None
    name: str
    scale: float = 1.0

    @property
    def world(self) -> Similarity:
        """From the poses' world into that of the Gaussians."""
        return Similarity(self.scale, np.eye(3), np.zeros(3))


def edited(splats: Splats, edit: Edit, added: Splats | None) -> tuple[Gaussians, int]:
    """The Gaussians after an edit, and how many it affected.

    Raises `UserError` if it would affect none or leave none, if its coordinates need a rig that is unknown, or if it
    adds splats that are not given.
    """
    if isinstance(edit, Add):
        more = _placed(edit, splats, added)
        return joined(splats.gaussians, more), len(more)
    inside = _inside(splats, edit.region)
    if isinstance(edit, Remove):
        return _without(splats.gaussians, inside), int(inside.sum())
    return _recoloured(splats.gaussians, inside, edit), int(inside.sum())


def _recoloured(gaussians: Gaussians, inside: Bool[Tensor, " N"], edit: Recolour) -> Gaussians:
    matrix = recolouring(edit.hue, edit.saturation, edit.tint, edit.strength)
    base, rest = gaussians[SH_BASE].clone(), gaussians[SH_REST].clone()
    base[inside], rest[inside] = recoloured(base[inside], rest[inside], matrix)
    return gaussians.with_parameters({SH_BASE: base, SH_REST: rest})


def _without(gaussians: Gaussians, inside: Bool[Tensor, " N"]) -> Gaussians:
    if inside.all():
        raise UserError(
            "an edit would leave no Gaussian", found="a region with all of them", remedy="make the region smaller"
        )
    return gaussians.select(~inside)


def _placed(edit: Add, splats: Splats, added: Splats | None) -> Gaussians:
    """The Gaussians that an edit adds, placed in the scene. Splats without cameras use a frame of their own extent."""
    if added is None:
        raise UserError(
            "there is nothing to add", found="no input added", expected="splats", remedy="give edit_splats the input"
        )
    own = added.frame or splats_frame(added.gaussians.means.numpy())
    taken = added.gaussians.select(_inside(replace(added, frame=own), edit.only))
    turn = Rotation.from_euler("xyz", edit.turn, degrees=True).as_matrix()
    placement = Similarity(edit.scale, turn, np.array(edit.place))
    into, out_of = (_frame_of(splats), own) if edit.coordinates == "rig" else (splats.world, added.world)
    return moved(taken, into.compose(placement).compose(out_of.inverse()))


def _inside(splats: Splats, where: EditedRegion | None) -> Bool[Tensor, " N"]:
    """Which Gaussians lie in a region, or all without one. Raises `UserError` if none do."""
    if where is None:
        return torch.ones(len(splats.gaussians), dtype=torch.bool)
    frame = _frame_of(splats) if where.coordinates == "rig" else splats.world
    means = splats.gaussians.means.numpy().astype(np.float64)
    inside = Region(where.shape, np.array(where.centre), np.array(where.size), frame).contains(means)
    if not inside.any():
        low, high = np.quantile(frame.inverse().points(means), [0.05, 0.95], axis=0).round(3).tolist()
        raise UserError(
            "no Gaussian lies in an edit's region",
            found=f"a {where.shape} of the size {where.size} about {where.centre}",
            expected=f"a part of where Gaussians are: most are between {low} and {high} in those coordinates",
            remedy="change its centre, its size or its coordinates",
        )
    return torch.from_numpy(inside)


def _frame_of(splats: Splats) -> Similarity:
    if splats.frame is None:
        raise UserError(
            "an edit's coordinates are those of a rig that is not known",
            found=f"no input {splats.name}",
            expected="the scene on which the splats were trained",
            remedy=f"give edit_splats the input {splats.name}, or say coordinates: world",
        )
    return splats.frame
