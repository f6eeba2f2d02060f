"""Grain: a watermark that is consistent across views, since it belongs to the Gaussians. Ours, not the paper's.

What a codec changes in a picture is tied to its pixels; no two views agree on it, and Gaussians fitted to watermarked
pictures keep next to nothing of it (fox, plain 3DGS: 48 dB between renders before and after). Grain instead changes
every Gaussian's colour a little, with a random sign (a coin): neighbours cancel, so there is no tint, only a grain.
Someone who knows the signs finds it in any picture of the scene (`GrainReader`), as in spread-spectrum watermarking
(Cox et al. 1997), but with a carrier in the scene instead of the picture.

Grain shows where pictures come from; it does not protect the Gaussians. To someone who has the changed Gaussians,
neighbours reveal most signs (`what_survives.md`). If colours were on a grid before, as in an 8-bit .splat, they reveal
all, since only one of the two signs leads back to the grid. Nothing here prevents that: a compressed file has a grid
for every chunk, which is no longer known.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from pipeline.errors import UserError
from stages.hiding.coupled import FEATURES
from stages.hiding.method import Method
from stages.hiding.photographs import photographs
from stages.hiding.rendering import COVER
from stages.hiding.stored_features import FARTHEST, stored
from stages.hiding.watermark.coins import Coins
from stages.hiding.watermark.colors import COLORS, GRAIN
from stages.scene.cameras import Camera, Cameras, single_cameras
from stages.scene.gaussians import Gaussians
from stages.scene.learnt_views import learnt_names
from stages.scene.scene import Scene
from stages.scene.spherical_harmonics import SH_BASE

SPACING = 16
"""Distance, in pixels, of those at which a decoder's derivatives are taken: more than its receptive field."""

MEASURED_ON = 8
"""Every eighth training view is used to measure a grain's strength."""

FOLLOWING = 0.9
"""Smallest share of the changed Gaussians whose change has the sign of their coins. Under grain all have it but for
rounding; for changes unrelated to the coins, about half do."""

DITHER = 1e-5
"""Largest magnitude of the uniform noise that is added to every changed value: hundreds of times float32's rounding
error, and a thousandth of the change. Without it, rounding reveals coins: of the two earlier values that a published
value may come from, often only one is a float32. For GS-Hider's 16 features on bonsai, this revealed 68 % of the coins,
all of them correctly, and undoing those changes removed the grain at no cost to the cover; for 3DGS's colours, it
revealed a tenth."""

OF_THE_ROOM = 0.5
"""The largest share of the room between a feature and the end of what can be stored that grain takes, whichever side
the coin is on. Clamping instead told coins with certainty: what was pushed across a bound lay exactly on it, by which
23 % of GS-Hider's coins on the fox were known (ours 9 %), and undoing these twofold took the scores from 31 to 37 down
to 9 to 13. Near an end, features still lean: by how densely they lie, 41 % of the coins were guessed, 80 % of these
rightly (ours: 64 and 66 %). With a quarter of the room it was 73 and 67 % (80 and 60 %), but a direction that is kept
for fewer Gaussians changes the message more. The same share for all features of a Gaussian halves the scores of
ours."""

ROUNDS = 8
"""Iterations that scale the change until renders differ as much as required; the difference is almost proportional to
it."""

REACHED = 0.95
"""A grain that shows less than this share of the strength that was asked for is reported."""


def measuring_cameras(scene: Scene) -> Cameras:
    """The cameras on whose pictures a grain's strength is measured. Raises `UserError` if all views are test views."""
    return scene.cameras.select(learnt_names(scene)[::MEASURED_ON])


def grained(
    gaussians: Gaussians,
    method: Method,
    cameras: Cameras,
    level: float,
    coins: Coins,
    dither: np.random.Generator,
    after_each: Callable[[], None] = lambda: None,
) -> Gaussians:
    """Add a grain of strength `level` to the Gaussians, with the signs in `coins`; `dither` draws the noise (`DITHER`).

    `level` is the root mean square difference of the covers' pixels and channels before and after, in levels of 255,
    over the given cameras, of which there must be at least one. Features near an end may have too little room for a
    large one (`level_shown`). Geometry does not change. The change is along the one direction of the constant harmonic,
    or of the coupled features, that shows in the grain's colour. With features, it shows in that colour only:
    luminance, the other colour direction, and the messages that the method shows do not change, as far as its decoders
    are linear. `after_each` is called after each picture. Raises `UserError` for Gaussians with neither attribute, and
    if no camera sees any change.
    """
    direction = _direction(gaussians, method, cameras, after_each)
    signs = torch.from_numpy(coins).float().to(gaussians.device)[:, None]
    noise = torch.from_numpy(dither.uniform(-DITHER, DITHER, (len(coins), len(direction)))).to(gaussians.device)
    before = _covers(gaussians, method, cameras, after_each)
    amount = 0.01
    for _ in range(ROUNDS):
        changed = _changed(gaussians, signs, amount * direction, noise)
        difference = _difference(_covers(changed, method, cameras, after_each), before)
        if difference == 0:
            raise UserError(
                "grain does not show in this container", found="renders that do not change with its Gaussians"
            )
        amount *= level / difference
    return _changed(gaussians, signs, amount * direction, noise)


def level_shown(
    before: Gaussians,
    after: Gaussians,
    method: Method,
    cameras: Cameras,
    asked: float,
    log: Callable[[str], None],
    after_each: Callable[[], None] = lambda: None,
) -> float:
    """The strength of a grain, measured as in `grained`; if it falls short of what was `asked`, a line in the log."""
    shown = _difference(*(_covers(each, method, cameras, after_each) for each in (after, before)))
    if shown < REACHED * asked:
        log(f"the grain shows {shown:.2f} of 255 levels, not {asked:g}: features near 0 or 1 have no room for more")
    return shown


def follows(before: Gaussians, after: Gaussians, coins: Coins) -> bool:
    """Whether two containers differ as a grain of these coins makes them differ.

    False if they are equal, and if any Gaussian was moved.
    """
    if not torch.equal(before.means, after.means):
        return False
    name = FEATURES if FEATURES in before.parameters else SH_BASE
    values = [each[name].detach().double() for each in (before, after)]
    if name == FEATURES:
        values = [each.sigmoid() for each in values]  # a clamp at the ends, of earlier versions, is large before it
    change = values[1] - values[0]
    turned = torch.from_numpy(coins).to(change)[:, None] * change
    along = turned @ turned.mean(dim=0)
    moved = along != 0
    return bool(moved.any()) and float((along[moved] > 0).double().mean()) >= FOLLOWING


def _changed(
    gaussians: Gaussians, signs: Float[Tensor, "N 1"], amounts: Float[Tensor, " M"], noise: Float64[Tensor, "N M"]
) -> Gaussians:
    """Add `amounts`, by the signs, and noise to activated features or to the constant harmonic.

    A feature with too little room on either side is changed less, by as much for either sign (`OF_THE_ROOM`), and one
    without any not at all.
    """
    change = signs * amounts + noise
    if FEATURES in gaussians.parameters:
        features = gaussians[FEATURES].detach().double().sigmoid()
        room = (FARTHEST - (features - 0.5).abs()).clamp_min(0)
        share = (OF_THE_ROOM * room / (amounts.abs().double() + DITHER)).clamp_max(1)
        moved = torch.where(room > 0, stored(features + share * change), gaussians[FEATURES].detach())
        return gaussians.with_parameters({FEATURES: moved})
    return gaussians.with_parameters({SH_BASE: (gaussians[SH_BASE].detach().double() + change).float()})


def _direction(
    gaussians: Gaussians, method: Method, cameras: Cameras, after_each: Callable[[], None]
) -> Float[Tensor, " M"]:
    if FEATURES in gaussians.parameters:
        shown = []
        for camera in single_cameras(cameras):
            shown.append(_derivatives(gaussians, method, camera))
            after_each()
        return torch.linalg.pinv(torch.stack(shown).mean(0))[:, GRAIN]
    if SH_BASE not in gaussians.parameters:
        raise UserError(
            "grain needs coupled features or a constant harmonic",
            found=", ".join(gaussians.attributes),
            expected=f"{FEATURES} or {SH_BASE}",
        )
    return COLORS[GRAIN].to(gaussians.device)


def _derivatives(gaussians: Gaussians, method: Method, camera: Camera) -> Float[Tensor, "C M"]:
    """Derivatives of the cover's three colours and of all messages' channels by the feature map at the same pixel."""
    leaf = gaussians[FEATURES].detach().clone().requires_grad_(True)
    rendering = method.render(gaussians.with_parameters({FEATURES: leaf}), camera)
    cover = rendering.pictures[COVER] @ COLORS.T.to(gaussians.device)
    messages = [picture for name, picture in rendering.pictures.items() if name != COVER]
    channels = torch.cat([cover, *messages], dim=-1)[SPACING // 2 :: SPACING, SPACING // 2 :: SPACING]
    rows = [
        torch.autograd.grad(channel.sum(), rendering.feature_map, retain_graph=True)[0]
        for channel in channels.unbind(dim=-1)
    ]
    return torch.stack([row[SPACING // 2 :: SPACING, SPACING // 2 :: SPACING].mean(dim=(0, 1)) for row in rows])


def _covers(
    gaussians: Gaussians, method: Method, cameras: Cameras, after_each: Callable[[], None]
) -> Float[Tensor, "V H W 3"]:
    pictures = []
    for rendering in photographs(gaussians, method, cameras):
        pictures.append(rendering.pictures[COVER])
        after_each()
    return torch.stack(pictures)


def _difference(pictures: Float[Tensor, "V H W 3"], others: Float[Tensor, "V H W 3"]) -> float:
    """The root mean square difference, in levels of 255."""
    return 255 * float((pictures - others).square().mean().sqrt())
