"""Re-optimisation: the attacker continues the container's training on the cover's views alone."""

from __future__ import annotations

import copy
from collections.abc import Callable

from stages.analysis.attacks.target import Attacker, Knowledge, Target
from stages.hiding.method import Method, move_networks
from stages.scene.gaussians import Gaussians
from stages.training.loop import Training, TrainingSettings
from stages.training.objectives import cover_term

SSIM_WEIGHT = 0.2
"""γ of Eq. 6."""

NETWORK_RATE = 1e-4
"""The decoders' final learning rate in `hide`; at their initial rate, the first steps cost the cover over 1 dB."""


def reoptimisation(iterations: int, frozen: bool) -> Callable[[Target, int, Knowledge], Attacker]:
    """An attack that trains the container for up to `iterations` on Eq. 6 alone, the cover's loss on its photos.

    The attacker knows the training photos, and builds the method from the container without the secret. The severity is
    the number of iterations: snapshots of one run. If `frozen`, the scene decoder does not change.

    Learning rates are those at the end of a training, but half of that for features (2.5e-3, as in the released code)
    and 3DGS's constant ones for scales, rotations and opacities. No Gaussian is added or removed. Attributes that the
    cover does not show, such as a message's harmonics, get no gradient and stay.
    """

    def prepare(target: Target, seed: int, knowledge: Knowledge) -> Attacker:
        return _Run(target, seed, knowledge, iterations, frozen)

    return prepare


class _Run:
    """A training in progress, from which snapshots are taken after increasing numbers of iterations."""

    def __init__(self, target: Target, seed: int, knowledge: Knowledge, iterations: int, frozen: bool):
        gaussians = _copied(target.gaussians).to(knowledge.device)
        method = copy.deepcopy(target.method)
        move_networks(method, knowledge.device)
        for network in method.networks.values():
            network.requires_grad_(not frozen)
        untouched = dict.fromkeys(gaussians.attributes.keys() - method.learning_rates.keys(), 0.0)
        settings = TrainingSettings(
            iterations,
            knowledge.extent,
            seed,
            schedule_share=0.0,
            attribute_rates=untouched,
            network_rate=NETWORK_RATE,
            density=None,
        )
        self.knowledge = knowledge
        self.training = Training(gaussians, method, knowledge.views, [cover_term(SSIM_WEIGHT)], settings)

    def __call__(self, iterations: float) -> Target:
        """A copy of the container after this many iterations. Raises `ValueError` if the training is past them."""
        training = self.training
        if iterations < training.iteration:
            raise ValueError(f"after {training.iteration} iterations there is no way back to {iterations:g}")
        while training.iteration < iterations:
            training.step(training.iteration + 1)
            training.iteration += 1
            self.knowledge.after_each()
        return Target(_copied(training.gaussians).to("cpu"), _fixed(training.method))


def _copied(gaussians: Gaussians) -> Gaussians:
    return Gaussians({name: values.detach().clone() for name, values in gaussians.parameters.items()})


def _fixed(method: Method) -> Method:
    copied = copy.deepcopy(method)
    move_networks(copied, "cpu")
    for network in copied.networks.values():
        network.requires_grad_(False)
    return copied
