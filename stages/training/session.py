"""Running a training inside a stage: resuming from a checkpoint, saving new ones, reporting progress, stopping."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from pipeline.checkpoint import Checkpoint, Checkpoints, State
from pipeline.errors import Interrupted, UserError
from pipeline.stage import Context
from stages.hiding.rendering import COVER
from stages.imaging.metric_table import MetricRow
from stages.timing.stopwatch import Stopwatch, part, watching
from stages.training.checkpoints import checkpoints_on
from stages.training.gpu_memory import too_large
from stages.training.loop import Training
from stages.training.state import set_state, state_of

CHECKPOINTS = "checkpoints"
"""A part of an iteration, for the stopwatch."""


def train(context: Context, training: Training, checkpoints: Checkpoints | None = None) -> list[MetricRow]:
    """Run all remaining iterations; returns the curves of all of them, and logs where the time went.

    Raises `Interrupted` when the engine asks to stop, after at most one iteration and with a checkpoint saved.
    """
    iterations = training.settings.iterations
    if checkpoints is None:
        checkpoints = checkpoints_on(context, training.device)
    with watching(Stopwatch()) as stopwatch:
        session = _Session(context, training, checkpoints, stopwatch)
        try:
            session.go_on()
            curves = training.run(session.look)
        except torch.OutOfMemoryError as error:
            raise _too_large(error, training) from error
        context.log(stopwatch.table(iterations))
    return curves


def _too_large(error: torch.OutOfMemoryError, training: Training) -> UserError:
    cameras = training.views.cameras
    return too_large(
        error,
        f"iteration {training.iteration + 1}",
        remedy="bound the Gaussians (maximum_gaussians), or train on smaller pictures",
        of_what=f"{len(training.gaussians)} Gaussians, pictures of {cameras[0].width} x {cameras[0].height}",
    )


class _Session:
    def __init__(self, context: Context, training: Training, checkpoints: Checkpoints, stopwatch: Stopwatch):
        self.context, self.training = context, training
        self.checkpoints, self.stopwatch = checkpoints, stopwatch
        self.told_of_bound = False

    def go_on(self) -> None:
        """Resume from the last valid checkpoint, if there is one."""
        with part(CHECKPOINTS):
            found = self.checkpoints.newest()
            if found is not None:
                self._go_on_from(found)
        if self.context.stop_requested():
            raise Interrupted(f"stopped before iteration {self.training.iteration + 1}")

    def _go_on_from(self, found: Checkpoint) -> None:
        values: Mapping[str, Any] = found.state.values
        set_state(self.training, found.state)
        self.told_of_bound = self.training.density is not None and self.training.density.limited
        self.stopwatch.add(values["seconds"])
        iterations = self.training.settings.iterations
        self.context.log(
            f"goes on from iteration {self.training.iteration} of {iterations} (checkpoint of {found.written})"
        )

    def look(self) -> None:
        """Report progress, save checkpoints and stop on request, after every iteration."""
        training, iterations = self.training, self.training.settings.iterations
        newest = training.curves.newest(training.iteration, len(training.gaussians))
        self.context.progress(training.iteration, iterations, loss=newest.loss, psnr=newest.decibels[COVER])
        self._tell_of_bound()
        with part(CHECKPOINTS):
            self.checkpoints.save_or_stop(self._state, f"stopped after iteration {training.iteration} of {iterations}")

    def _tell_of_bound(self) -> None:
        """Log once that the bound was reached: 3DGS has none, so that figures of such a training are not its own."""
        density = self.training.density
        if density is not None and density.limited and not self.told_of_bound:
            self.told_of_bound = True
            self.context.log(
                f"growth is limited to maximum_gaussians, {density.settings.maximum_gaussians:,}, from iteration "
                f"{self.training.iteration} on"
            )

    def _state(self) -> State:
        state = state_of(self.training)
        return State(state.arrays, {**state.values, "seconds": [list(entry) for entry in self.stopwatch.reading()]})
