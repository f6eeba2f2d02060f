"""All attacks by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stages.analysis.attacks import features, quantisation, renders, rigid_motion
from stages.analysis.attacks.catalogue import PRUNED_SHARES, AttackName
from stages.analysis.attacks.noise import noise
from stages.analysis.attacks.pruning import cloning, cropping, random_pruning, sequential_pruning
from stages.analysis.attacks.reoptimisation import reoptimisation
from stages.analysis.attacks.stripping import stripping
from stages.analysis.attacks.target import Attack, Target, seeded, unseeded
from stages.analysis.attacks.unread_directions import unread_directions
from stages.analysis.attacks.view_weights import ViewWeights, view_weight_clustering, view_weight_pruning

MOST_PRUNED = 0.95
MOST_NOISE = 1.0
"""The strongest noise, in standard deviations of the values it is added to."""

STRIPPED_SHARES = (0.2, 0.4, 0.6, 0.8, 1.0)


def attacks(reoptimised: Sequence[int]) -> Mapping[AttackName, Attack]:
    """Every attack by name; re-optimised containers are measured after each number of iterations in `reoptimised`."""
    steps = tuple(float(count) for count in sorted(reoptimised))
    longest = max(reoptimised)
    weights_of = ViewWeights()
    return {
        "sequential_pruning": Attack(
            unseeded(sequential_pruning), strongest=MOST_PRUNED, fixed=PRUNED_SHARES, random=False
        ),
        "random_pruning": Attack(seeded(random_pruning), strongest=MOST_PRUNED, fixed=PRUNED_SHARES),
        "view_weight_pruning": Attack(view_weight_pruning(weights_of), strongest=MOST_PRUNED),
        "view_weight_clustering": Attack(view_weight_clustering(weights_of), strongest=MOST_PRUNED),
        "stripping": Attack(
            seeded(stripping), lambda target: STRIPPED_SHARES, applies=lambda target: bool(target.own_attributes)
        ),
        "noise_positions": Attack(seeded(noise(["means"])), strongest=MOST_NOISE),
        "noise_rotations": Attack(seeded(noise(["quats"])), strongest=MOST_NOISE),
        "noise_scales": Attack(seeded(noise(["log_scales"])), strongest=MOST_NOISE),
        "noise_opacities": Attack(seeded(noise(["logit_opacities"])), strongest=MOST_NOISE),
        "noise_colours": Attack(seeded(noise([])), strongest=MOST_NOISE),
        "quantisation": Attack(
            unseeded(quantisation.quantisation), lambda target: quantisation.SEVERITIES, random=False
        ),
        "cloning": Attack(seeded(cloning)),
        "cropping": Attack(seeded(cropping), strongest=MOST_PRUNED),
        "rigid_motion": Attack(seeded(rigid_motion.rigid_motion), lambda target: rigid_motion.SEVERITIES),
        "channel_dropping": Attack(seeded(features.channel_dropping), features.channel_counts, applies=_has_features),
        "unread_directions": Attack(unread_directions, features.channel_counts, applies=_decoder_follows),
        "channel_permutation": Attack(
            seeded(features.channel_permutation), features.permuted_counts, applies=_decoder_follows
        ),
        "feature_mixing": Attack(
            seeded(features.feature_mixing), lambda target: features.MIXED_SHARES, applies=_decoder_follows
        ),
        "feature_rotation": Attack(seeded(features.feature_rotation), strongest=90.0, applies=_has_features),
        "compensated_rotation": Attack(
            seeded(features.compensated_rotation), lambda target: features.ANGLES, applies=_decoder_follows
        ),
        "reoptimisation": Attack(reoptimisation(longest, frozen=False), lambda target: steps),
        "reoptimisation_frozen": Attack(
            reoptimisation(longest, frozen=True),
            lambda target: steps,
            applies=lambda target: bool(target.method.networks),
        ),
        "jpeg": Attack(unseeded(renders.jpeg), lambda target: renders.QUALITIES, applies=_in_renders, random=False),
        "resizing": Attack(
            unseeded(renders.resizing), lambda target: renders.FACTORS, applies=_in_renders, random=False
        ),
    }


def _has_features(target: Target) -> bool:
    return target.has_features


def _decoder_follows(target: Target) -> bool:
    return target.decoder_follows_features


def _in_renders(target: Target) -> bool:
    return target.shows_message_in_renders
