"""Grain: a watermark that all views agree about, since it belongs to the Gaussians. Ours, not the paper's.

What a codec changes in a picture is tied to its pixels; no two views agree about it, and Gaussians that are fitted to
watermarked pictures keep next to nothing of it (fox, plain 3DGS: renders 48 dB from those before). So every Gaussian is
changed a little in colour, one way or the other as a coin falls: neighbours cancel, there is no tint, and a grain
remains. Who knows the coins finds it in any picture of the scene (`GrainReader`), as spread-spectrum watermarks are
found (Cox et al. 1997), here with a carrier that lives in the scene and not in the picture.

It tells where pictures come from, and is no lock: to who has the changed Gaussians, neighbours give most coins away
(`what_survives.md`). Where colours lay on a grid before, as in a .splat of 8 bits, they give all away, for one of two
coins leads back to the grid. Nothing here hides that: a compressed file has a grid for every chunk, which is not known
any more.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.errors import UserError
from stages.hiding.coupled import FEATURE_RANGE, FEATURES
from stages.hiding.method import Method
from stages.hiding.photographs import photographs
from stages.hiding.rendering import COVER
from stages.hiding.stored_features import stored
from stages.hiding.watermark.coins import Coins
from stages.hiding.watermark.colors import COLORS, GRAIN
from stages.scene.cameras import Camera, Cameras, single_cameras
from stages.scene.gaussians import Gaussians

BASE = "sh_base"
"""The constant harmonic of methods without features."""

SPACING = 16
"""Pixels between those that a decoder's derivatives are taken at: farther apart than it sees."""

MEASURED_ON = 8
"""Every eighth training view tells how strong a grain is."""

FOLLOWING = 0.9
"""At least this share of the Gaussians that a grain changed went the way of their coins. All do but where features were
at their bounds; of those that know nothing of the coins about half."""

ROUNDS = 8
"""Of scaling the change until renders differ as much as asked for; they follow it almost in proportion."""


def grained(gaussians: Gaussians, method: Method, cameras: Cameras, level: float, coins: Coins) -> Gaussians:
    """Gaussians, changed as the coins fell, whose covers differ by a grain of `level` from those before.

    Root mean square over pixels and channels, in levels of 255, on the cameras given, at least one. Geometry stays. The
    change goes along the one direction of the constant harmonic, or of the coupled features, that shows in the grain's
    colour; with features, in that one alone: luminance, the other colour, and the messages that the method shows stay
    as they are as far as its decoders are linear. Raises `UserError` for Gaussians with neither, and where no camera
    sees any.
    """
    direction = _direction(gaussians, method, cameras)
    signs = torch.from_numpy(coins).float().to(gaussians.device)
    before = _covers(gaussians, method, cameras)
    amount = 0.01
    for _ in range(ROUNDS):
        changed = _changed(gaussians, signs[:, None] * (amount * direction))
        difference = 255 * float((_covers(changed, method, cameras) - before).square().mean().sqrt())
        if difference == 0:
            raise UserError(
                "grain does not show in this container", found="renders that do not change with its Gaussians"
            )
        amount *= level / difference
    return _changed(gaussians, signs[:, None] * (amount * direction))


def follows(before: Gaussians, after: Gaussians, coins: Coins) -> bool:
    """Whether these differ as a grain of these coins has them differ; not where they are alike, or at other places."""
    if not torch.equal(before.means, after.means):
        return False
    name = FEATURES if FEATURES in before.parameters else BASE
    change = after[name].detach().double() - before[name].detach().double()
    turned = torch.from_numpy(coins).to(change)[:, None] * change
    along = turned @ turned.mean(dim=0)
    moved = along != 0
    return bool(moved.any()) and float((along[moved] > 0).double().mean()) >= FOLLOWING


def _changed(gaussians: Gaussians, change: Float[Tensor, "N M"]) -> Gaussians:
    """With this added to activated features, which stay in the range that they begin in, or to the harmonic."""
    if FEATURES in gaussians.parameters:
        features = gaussians[FEATURES].detach().double().sigmoid()
        lowest, highest = (torch.full_like(features, bound) for bound in FEATURE_RANGE)
        moved = (features + change).clamp(torch.minimum(features, lowest), torch.maximum(features, highest))
        return Gaussians(gaussians.parameters | {FEATURES: stored(moved)})
    return Gaussians(gaussians.parameters | {BASE: gaussians[BASE].detach() + change})


def _direction(gaussians: Gaussians, method: Method, cameras: Cameras) -> Float[Tensor, " M"]:
    if FEATURES in gaussians.parameters:
        shown = torch.stack([_derivatives(gaussians, method, camera) for camera in single_cameras(cameras)]).mean(0)
        return torch.linalg.pinv(shown)[:, GRAIN]
    if BASE not in gaussians.parameters:
        raise UserError(
            "grain needs coupled features or a constant harmonic",
            found=", ".join(gaussians.attributes),
            expected=f"{FEATURES} or {BASE}",
        )
    return COLORS[GRAIN].to(gaussians.device)


def _derivatives(gaussians: Gaussians, method: Method, camera: Camera) -> Float[Tensor, "C M"]:
    """Of the cover's three colours, and then of all messages' channels, by the feature map at the same pixel."""
    leaf = gaussians[FEATURES].detach().clone().requires_grad_(True)
    rendering = method.render(Gaussians(gaussians.parameters | {FEATURES: leaf}), camera)
    cover = rendering.pictures[COVER] @ COLORS.T.to(gaussians.device)
    messages = [picture for name, picture in rendering.pictures.items() if name != COVER]
    channels = torch.cat([cover, *messages], dim=-1)[SPACING // 2 :: SPACING, SPACING // 2 :: SPACING]
    rows = [
        torch.autograd.grad(channel.sum(), rendering.feature_map, retain_graph=True)[0]
        for channel in channels.unbind(dim=-1)
    ]
    return torch.stack([row[SPACING // 2 :: SPACING, SPACING // 2 :: SPACING].mean(dim=(0, 1)) for row in rows])


def _covers(gaussians: Gaussians, method: Method, cameras: Cameras) -> Float[Tensor, "V H W 3"]:
    return torch.stack([rendering.pictures[COVER] for rendering in photographs(gaussians, method, cameras)])
