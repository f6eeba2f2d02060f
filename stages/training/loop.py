"""The common optimisation loop: plain 3DGS, hiding and fine-tuning differ only in their method and objective."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stages.hiding.message_names import LOSS
from stages.hiding.method import Method
from stages.hiding.rendering import ACTIVATIONS, Rendering
from stages.imaging.metric_table import MetricRow
from stages.scene.cameras import Camera
from stages.scene.gaussians import Gaussians
from stages.timing.stopwatch import part
from stages.training.adam import Adam
from stages.training.averaging import Averages
from stages.training.backward import in_one_thread
from stages.training.curves import Curves
from stages.training.density_control import DensityControl, DensitySettings
from stages.training.divergence import refuse_divergence, refuse_not_finite
from stages.training.objectives import Compared, FixedView, PictureTerm, total_loss
from stages.training.optimizer import GaussianOptimizer
from stages.training.prior import prior
from stages.training.sampling import ViewSampler
from stages.training.schedules import decayed, density_schedule

DENSITY_CONTROL = "density control"
LOSS_PART = "loss"


@dataclass(frozen=True)
class TrainingViews:
    """T views to learn from: a camera each, and T pictures for every name that the objective compares.

    All are on the CPU, wherever the training runs: a GPU only needs room for the pictures of one view. They may share
    memory with what they were read from.
    """

    cameras: tuple[Camera, ...]
    pictures: Mapping[str, Sequence[UInt8[Tensor, "H W 3"]]]

    def truths(self, view: int, device: torch.device | str = "cpu") -> dict[str, Tensor]:
        """The pictures of one view on a device, float32 in [0, 1]. They are moved as bytes, a quarter of the data."""
        return {name: pictures[view].to(device).float() / 255 for name, pictures in self.pictures.items()}


@dataclass(frozen=True)
class TrainingSettings:
    """3DGS's constants. The rig's `extent` scales positions' learning rate; `density` None keeps the Gaussians' number.

    Schedules are 3DGS's, scaled to the first `schedule_share` of the iterations; later iterations keep the last rates.
    `attribute_rates` replace the method's own learning rates; they and `network_rate` decay exponentially to
    `final_rate_share` of themselves. `averaging` is the decay of the averages that replace the final values; 0 for
    none. `opacity_weight` and `scale_weight` are those of the prior. A prior on opacities lowers them all the time, in
    place of 3DGS's resets, as in 3DGS-MCMC: Gaussians made transparent by a reset could not recover against it. With
    `goes_on`, for Gaussians that are already trained, all degrees of their harmonics are in use from the first
    iteration on.
    """

    iterations: int
    extent: float
    seed: int
    position_rate: float = 1.6e-4
    final_position_rate: float = 1.6e-6
    scale_rate: float = 5e-3
    rotation_rate: float = 1e-3
    opacity_rate: float = 5e-2
    network_rate: float = 1e-3
    final_rate_share: float = 1.0
    schedule_share: float = 1.0
    averaging: float = 0.0
    opacity_weight: float = 0.0
    scale_weight: float = 0.0
    goes_on: bool = False
    attribute_rates: Mapping[str, float] = field(default_factory=dict)
    density: DensitySettings | None = field(default_factory=DensitySettings)

    @property
    def scheduled(self) -> int:
        """The number of iterations to which schedules are scaled."""
        return max(1, round(self.schedule_share * self.iterations))


Observer = Callable[[], None]
"""Called after every iteration, when the state is consistent."""


class Training:
    """A training in progress: Gaussians, networks, their optimizers, and every source of randomness.

    It runs on the device of its Gaussians, where the method's networks must be, too; only random numbers are drawn on
    the CPU. `state` saves and restores everything that changes: whatever is added here must be added there.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        method: Method,
        views: TrainingViews,
        terms: Sequence[PictureTerm],
        settings: TrainingSettings,
        fixed: Sequence[FixedView] = (),
    ):
        self.gaussians, self.method, self.views, self.terms, self.settings = gaussians, method, views, terms, settings
        self.device = gaussians.device
        self.fixed = [replace(view, truth=view.truth.to(self.device)) for view in fixed]
        self.optimizer = GaussianOptimizer(gaussians, self._learning_rates())
        self.network_optimizer = self._network_optimizer()
        self.sampler = ViewSampler(len(views.cameras), settings.seed)
        self.generator = torch.Generator().manual_seed(settings.seed)
        self.schedule = density_schedule(settings.scheduled, opacity_resets=settings.opacity_weight == 0)
        self.averages = Averages(settings.averaging, settings.iterations)
        self.iteration = 0
        self.curves = Curves(settings.iterations, [*terms, *(view.term for view in fixed)], method.name)
        self.density = (
            DensityControl(settings.density, settings.extent, len(gaussians), self.device)
            if settings.density is not None
            else None
        )

    def _learning_rates(self) -> dict[str, float]:
        settings = self.settings
        return {
            "means": settings.position_rate * settings.extent,
            "quats": settings.rotation_rate,
            "log_scales": settings.scale_rate,
            "logit_opacities": settings.opacity_rate,
            **self.method.learning_rates,
            **settings.attribute_rates,
        }

    def _network_optimizer(self) -> Adam | None:
        weights = [weight for network in self.method.networks.values() for weight in network.parameters()]
        return Adam(weights, lr=self.settings.network_rate, fused=True) if weights else None

    def step(self, iteration: int) -> dict[str, float]:
        """Take one step on one view; `iteration` counts from 1. Returns the loss and each picture's mean squared error.

        Raises `UserError` if the loss is NaN or infinite.
        """
        settings = self.settings
        progress = min(1.0, iteration / settings.scheduled)
        self._set_learning_rates(progress)
        shown_at = 1.0 if settings.goes_on else progress
        with part("data"):
            view = self.sampler.draw()
            camera, truths = self.views.cameras[view], self.views.truths(view, self.device)
        with part(ACTIVATIONS):
            rendering = self.method.render(self.gaussians, camera, shown_at, [term.picture for term in self.terms])
        compared = [Compared(term, rendering.pictures[term.picture], truths[term.picture]) for term in self.terms]
        compared += [self._seen(view, shown_at) for view in self.fixed]
        with part(LOSS_PART):
            loss = total_loss(compared)
            for penalty in self._penalties():
                loss = loss + penalty / len(self.views.cameras)
        with part(LOSS_PART, "backward"), in_one_thread():
            loss.backward()
        with part("figures"), torch.no_grad():
            figures = {LOSS: float(loss)} | {each.term.picture: each.squared_error() for each in compared}
        refuse_divergence(figures[LOSS], iteration)
        self._update(iteration, rendering, camera)
        return figures

    def _penalties(self) -> list[Float[Tensor, ""]]:
        """The loss terms other than pictures, for all training views together: the method's penalty and the prior."""
        settings = self.settings
        weighed = prior(self.gaussians, settings.opacity_weight, settings.scale_weight, settings.extent)
        return [penalty for penalty in (self.method.penalty(self.gaussians), weighed) if penalty is not None]

    def _seen(self, view: FixedView, progress: float) -> Compared:
        """Render what a fixed camera sees. Only the sampled views determine where density control adds Gaussians."""
        with part(ACTIVATIONS):
            rendering = self.method.render(self.gaussians, view.camera, progress, [view.term.picture])
        return Compared(view.term, rendering.pictures[view.term.picture], view.truth.float() / 255)

    def _set_learning_rates(self, progress: float) -> None:
        """Decay positions' rate as in 3DGS, and those of `attribute_rates` and networks down to `final_rate_share`."""
        settings = self.settings
        position_rate = decayed(settings.position_rate, settings.final_position_rate, progress)
        self.optimizer.set_learning_rate("means", position_rate * settings.extent)
        share = decayed(1.0, settings.final_rate_share, progress)
        for name, rate in settings.attribute_rates.items():
            self.optimizer.set_learning_rate(name, rate * share)
        if self.network_optimizer is not None:
            self.network_optimizer.param_groups[0]["lr"] = settings.network_rate * share

    def _update(self, iteration: int, rendering: Rendering, camera: Camera) -> None:
        """Adam's step, then density control.

        3DGS refines and resets first. That voids Adam's step, for all Gaussians at each refinement and for opacities at
        each reset; it also takes no step in the last iteration.
        """
        if self.density is not None and iteration <= self.schedule.stop:
            with part(DENSITY_CONTROL):
                self.density.observe(rendering, camera.width, camera.height)
        with part("optimizer"):
            self.optimizer.step()
            if self.network_optimizer is not None:
                self.network_optimizer.step()
                self.network_optimizer.zero_grad(set_to_none=True)
        if self.density is not None:
            with part(DENSITY_CONTROL):
                self._refine(self.density, iteration)

    def _refine(self, density: DensityControl, iteration: int) -> None:
        if self.schedule.densifies_at(iteration):
            past_reset = iteration > self.schedule.opacity_reset_interval
            density.refine(self.optimizer, past_reset, self.generator)
        if self.schedule.resets_opacity_at(iteration):
            density.reset_opacity(self.optimizer)

    def run(self, observe: Observer) -> list[MetricRow]:
        """Run the remaining iterations; returns the training curves from the first iteration on.

        Raises `UserError` if a loss, or in the end a Gaussian, is not finite.
        """
        while self.iteration < self.settings.iterations:
            figures = self.step(self.iteration + 1)
            self.iteration += 1
            self.averages.add(self.iteration, self.gaussians, self.method)
            self.curves.add(self.iteration, figures, len(self.gaussians))
            observe()
        self.averages.apply(self.gaussians, self.method)
        refuse_not_finite(self.gaussians)
        return self.curves.rows()
