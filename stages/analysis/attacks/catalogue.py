"""Names of the attacks and the meaning of their severities: text only, for pages and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

AttackName = Literal[
    "sequential_pruning",
    "random_pruning",
    "view_weight_pruning",
    "view_weight_clustering",
    "stripping",
    "noise_positions",
    "noise_rotations",
    "noise_scales",
    "noise_opacities",
    "noise_colours",
    "quantisation",
    "cloning",
    "cropping",
    "rigid_motion",
    "channel_dropping",
    "unread_directions",
    "channel_permutation",
    "feature_mixing",
    "feature_rotation",
    "compensated_rotation",
    "reoptimisation",
    "reoptimisation_frozen",
    "jpeg",
    "resizing",
]

UNATTACKED = "none"
"""The condition under which figures of the unattacked container are recorded."""

ONE_COLOUR = "psnr_one_colour"
"""Reference for the messages' `psnr`, over whole pictures as well: the PSNR of the best single-colour picture."""

PRUNED_SHARES = (0.05, 0.10, 0.15, 0.25)
"""Shares of the Gaussians in the paper's table "Robustness analysis under different pruning methods"."""


@dataclass(frozen=True)
class Description:
    """What the `severity` measures, with its unit; what `hurts` a message most, if anything does; and why some
    containers cannot be attacked in this way (`needs`), empty if all can."""

    title: str
    severity: str
    hurts: str
    needs: str = ""


_NEEDS_FEATURES = "the method has no features"
_IN_RENDERS = "the message is not in the renders"
_THE_MESSAGES_OWN = (
    "Gaussians that weigh much in the feature map, and that the scene decoder hardly shows, are the message's own"
)

ATTACKS: Mapping[AttackName, Description] = {
    "sequential_pruning": Description(
        "Sequential pruning", "share of the Gaussians, lowest opacity first", "it takes what the message shows faintly"
    ),
    "random_pruning": Description(
        "Random pruning", "share of the Gaussians", "it opens holes through which the cover shows"
    ),
    "view_weight_pruning": Description("View-weight pruning", "share of the Gaussians", _THE_MESSAGES_OWN),
    "view_weight_clustering": Description(
        "View-weight pruning by clusters", "share of the Gaussians", _THE_MESSAGES_OWN
    ),
    "stripping": Description(
        "Stripping",
        "share of the Gaussians that lose the attributes which 3DGS does not have",
        "the message is kept in attributes that the cover does not need",
        needs="the container has none but 3DGS's attributes",
    ),
    "noise_positions": Description("Noise on positions", "sigma over the spread", "surfaces of the message scatter"),
    "noise_rotations": Description("Noise on rotations", "sigma over the spread", "thin Gaussians turn"),
    "noise_scales": Description("Noise on scales", "sigma over the spread", "Gaussians of the message swell"),
    "noise_opacities": Description("Noise on opacities", "sigma over the spread", "the cover covers the message"),
    "noise_colours": Description(
        "Noise on features or harmonics",
        "sigma over the spread",
        "the message's share of a feature is smaller than the cover's, so that the same noise is more to it",
    ),
    "quantisation": Description(
        "Quantisation",
        "bits a value, 16: half precision (positions always 16, in equal steps)",
        "the message's share of a feature is a few steps wide",
    ),
    "cloning": Description(
        "Cloning", "share of the Gaussians, doubled", "doubled Gaussians of the cover hide what lies behind"
    ),
    "cropping": Description(
        "Cropping out", "share of the Gaussians, those about a place", "the message's part is gone"
    ),
    "rigid_motion": Description(
        "Rigid motion",
        "degrees of the turn",
        "the message decoder is told directions of view in the world, which has turned; the attacker turned the scene "
        "decoder with it, and cannot turn the secret one",
    ),
    "channel_dropping": Description(
        "Channel dropping",
        "channels set to their mean",
        "each channel carries some of both pictures",
        needs=_NEEDS_FEATURES,
    ),
    "unread_directions": Description(
        "Unread directions removed",
        "directions of the features, least read by the scene decoder first",
        "the scene decoder, which is public, says which directions of a feature the cover does not need, and the "
        "message is read along these",
        needs=_NEEDS_FEATURES,
    ),
    "channel_permutation": Description(
        "Channels permuted, scene decoder with them",
        "channels that change places",
        "the scene decoder follows the channels, and the secret decoder cannot",
        needs=_NEEDS_FEATURES,
    ),
    "feature_mixing": Description(
        "Channels mixed, scene decoder with them",
        "share of each channel that comes from another",
        "the scene decoder follows the channels, and the secret decoder cannot",
        needs=_NEEDS_FEATURES,
    ),
    "feature_rotation": Description(
        "Feature rotation",
        "degrees",
        "both decoders read turned features alike",
        needs=_NEEDS_FEATURES,
    ),
    "compensated_rotation": Description(
        "Feature rotation, scene decoder turned with it",
        "degrees",
        "the scene decoder is turned with the features, and the secret decoder cannot be; one that reads blended "
        "features uncentred, as GS-Hider's does, cannot be turned exactly, which costs the cover",
        needs=_NEEDS_FEATURES,
    ),
    "reoptimisation": Description(
        "Re-optimisation",
        "iterations",
        "what the cover does not ask for is free to change, features and scene decoder together",
    ),
    "reoptimisation_frozen": Description(
        "Re-optimisation, scene decoder frozen", "iterations", "what the cover does not ask for is free to change"
    ),
    "jpeg": Description(
        "JPEG of the renders", "quality", "the message is in small differences of the picture", needs=_IN_RENDERS
    ),
    "resizing": Description(
        "Resizing of the renders",
        "how many times smaller",
        "the message is in small differences of the picture",
        needs=_IN_RENDERS,
    ),
}


def restored(condition: str) -> str:
    """The condition of an attacked container after its owner has restored it with the help of the published one.

    >>> restored("rigid_motion")
    'rigid_motion restored'
    """
    return f"{condition} restored"
