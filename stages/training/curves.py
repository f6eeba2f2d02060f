"""A training's curves: loss, PSNR of the training views and the number of Gaussians, one point per stretch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stages.hiding.message_names import LOSS
from stages.imaging.metric_table import MetricRow
from stages.training.objectives import PictureTerm
from stages.training.stretches import decibels_of, stretch_of


@dataclass(frozen=True)
class Point:
    """Means over the stretch that ends with `iteration`: the loss, and the PSNR in dB of each picture by name."""

    iteration: int
    gaussians: int
    loss: float
    decibels: Mapping[str, float]


class Curves:
    """The `points` so far, about a hundred in a whole training, and each iteration's figures since the last one."""

    def __init__(self, iterations: int, terms: Sequence[PictureTerm], method: str):
        self.iterations = iterations
        self.every = stretch_of(iterations)
        self.pictures = tuple(term.picture for term in terms)
        self.method = method
        self.points: list[Point] = []
        self.stretch: list[Mapping[str, float]] = []

    def add(self, iteration: int, figures: Mapping[str, float], gaussians: int) -> None:
        """Add one iteration's `loss`, and each picture's mean squared error by its name."""
        self.stretch.append(figures)
        if iteration % self.every == 0 or iteration == self.iterations:
            self.points.append(self._point(iteration, gaussians))
            self.stretch = []

    def newest(self, iteration: int, gaussians: int) -> Point:
        """The last point; before the first, the means over the iterations so far."""
        return self.points[-1] if self.points else self._point(iteration, gaussians)

    def rows(self) -> list[MetricRow]:
        """The points as rows of metrics, in order."""
        return [row for point in self.points for row in self._rows(point)]

    def _point(self, iteration: int, gaussians: int) -> Point:
        means = {name: sum(step[name] for step in self.stretch) / len(self.stretch) for name in (LOSS, *self.pictures)}
        return Point(iteration, gaussians, means[LOSS], {name: decibels_of(means[name]) for name in self.pictures})

    def _rows(self, point: Point) -> list[MetricRow]:
        return [
            MetricRow(LOSS, point.loss, split="train", iteration=point.iteration, method=self.method),
            MetricRow("gaussians", point.gaussians, iteration=point.iteration, method=self.method),
            *(
                MetricRow(
                    "psnr",
                    point.decibels[picture],
                    "dB",
                    split="train",
                    message=picture if position else None,
                    iteration=point.iteration,
                    method=self.method,
                )
                for position, picture in enumerate(self.pictures)
            ),
        ]
