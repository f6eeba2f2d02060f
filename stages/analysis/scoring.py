"""Scoring: every view of a trained scene is rendered and measured, and some pictures are kept for display."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stages.analysis.comparisons import Comparison
from stages.analysis.feature_map import feature_map_picture
from stages.analysis.fidelity import Perceptual, covered_figures, picture_figures, where_seen
from stages.analysis.leakage import matched_correlations
from stages.hiding.message_names import FEATURE_MAP
from stages.hiding.opening import ReadContainer
from stages.hiding.rendering import COVER, Rendering
from stages.imaging.metric_table import MetricRow
from stages.imaging.pictures import picture_to_tensor, tensor_to_picture
from stages.imaging.quantities import QUANTITIES
from stages.scene.gaussians import Gaussians
from stages.scene.message_views import MessageViews
from stages.scene.scene import Scene


@dataclass(frozen=True)
class HiddenImage:
    """An image hidden in the view named `view`, of the same size as the view."""

    name: str
    view: str
    picture: UInt8[np.ndarray, "H W 3"]


Pictures = dict[str, list[UInt8[np.ndarray, "H W 3"]]]


@dataclass
class Scores:
    """Metric rows, pictures by title for the views in `shown`, and the cover's residuals by test view, if kept.

    Pictures without a truth, such as feature maps, are in `rendered` alone.
    """

    method: str
    rows: list[MetricRow] = field(default_factory=list)
    shown: list[str] = field(default_factory=list)
    truths: Pictures = field(default_factory=dict)
    rendered: Pictures = field(default_factory=dict)
    residuals: dict[str, Float[np.ndarray, "H W 3"]] = field(default_factory=dict)
    hidden: tuple[HiddenImage, UInt8[np.ndarray, "H W 3"]] | None = None

    def add(self, view: str, split: str, figures: Mapping[str, float], message: str | None = None) -> None:
        """Add the rows of one picture."""
        self.rows += [
            MetricRow(name, value, QUANTITIES[name].unit, view, split, message, method=self.method)
            for name, value in figures.items()
        ]

    def show(self, picture: str, truth: UInt8[np.ndarray, "H W 3"] | None, rendered: Float[Tensor, "H W 3"]) -> None:
        """Keep one rendered picture with its truth, if it has one, under the title `picture`."""
        if truth is not None:
            self.truths.setdefault(picture, []).append(truth)
        self.rendered.setdefault(picture, []).append(tensor_to_picture(rendered))

    def comparisons(self, scene: Scene) -> list[Comparison]:
        """The kept pictures: the cover, the messages, the feature map, and the hidden image, in this order."""
        return [*self._views(scene), *self._hidden()]

    def _hidden(self) -> list[Comparison]:
        if self.hidden is None:
            return []
        image, found = self.hidden
        return [
            Comparison(image.name, "message", self.method, (image.view,), ("train",), image.picture[None], found[None])
        ]

    def _views(self, scene: Scene) -> list[Comparison]:
        tests = set(scene.test_names)
        splits = tuple("test" if name in tests else "train" for name in self.shown)
        return [
            Comparison(
                title=name,
                role="cover" if name == COVER else "feature_map" if name == FEATURE_MAP else "message",
                method=self.method,
                names=tuple(self.shown),
                splits=splits,
                truth=np.stack(self.truths.get(name, rendered)),
                rendered=np.stack(rendered),
                has_truth=name in self.truths,
            )
            for name, rendered in self.rendered.items()
        ]


def score(
    container: ReadContainer,
    name: str,
    scene: Scene,
    messages: Mapping[str, MessageViews],
    perceptual: Perceptual,
    shown_train_views: int,
    progress: Callable[[int, int], None],
    image: HiddenImage | None = None,
    keep_residuals: bool = False,
) -> Scores:
    """Measure every view, and keep pictures of all test views and of the first `shown_train_views` training views.

    `keep_residuals`, as `leakage_rows` needs them: those of all test views, in float32.

    LPIPS costs more than all other metrics together, so it is measured only on test views and, for a hidden image, on
    the view that hides it, whose pictures are kept as well.
    """
    scores = Scores(name)
    tests = set(scene.test_names)
    hiding = {image.view} if image is not None else set()
    shown = {*scene.test_names, *scene.train_names[:shown_train_views]} | hiding
    for row, rendering in enumerate(container.photographs(scene.cameras)):
        view = scene.cameras.names[row]
        split = "test" if view in tests else "train"
        measured = perceptual if view in tests else {}
        _score_cover(scores, rendering, scene, row, split, measured, keep_residuals and view in tests)
        for message in messages.values():
            _score_message(scores, rendering, message, row, split, measured)
        if view in shown:
            scores.shown.append(view)
            _show(scores, container.gaussians, rendering, scene, messages, row)
        if image is not None and view == image.view:
            _score_image(scores, rendering, image, perceptual)
        progress(row + 1, len(scene.cameras))
    return scores


def views_for_the_public(scene: Scene, shown_train_views: int) -> set[str]:
    """The views of which the public sees pictures: test views, and training views only if there are none of those.

    A training view that hides an image could stand out by how it differs from its photo.
    """
    return set(scene.test_names or scene.train_names[:shown_train_views])


def _score_cover(
    scores: Scores,
    rendering: Rendering,
    scene: Scene,
    row: int,
    split: str,
    perceptual: Perceptual,
    keep_residual: bool,
) -> None:
    picture = rendering.pictures[COVER]
    truth = picture_to_tensor(scene.pictures[row], picture.device)
    scores.add(scene.cameras.names[row], split, picture_figures(picture, truth, perceptual))
    if keep_residual:
        scores.residuals[scene.cameras.names[row]] = (picture.clamp(0, 1) - truth).cpu().numpy()


def _score_message(
    scores: Scores, rendering: Rendering, message: MessageViews, row: int, split: str, perceptual: Perceptual
) -> None:
    picture = rendering.pictures[message.name]
    truth = picture_to_tensor(message.pictures[row], picture.device)
    coverage = torch.from_numpy(message.coverage[row]).to(picture.device)
    figures = picture_figures(picture, truth, perceptual) | covered_figures(picture, truth, coverage)
    seen = {"coverage": float(coverage.mean()), "legal": float(message.legal[row])}
    scores.add(message.view_names[row], split, where_seen(figures, truth) | seen, message.name)


def _score_image(scores: Scores, rendering: Rendering, image: HiddenImage, perceptual: Perceptual) -> None:
    """Score the hidden image in its own view; what the decoder shows in other views is undefined."""
    picture = rendering.pictures[image.name]
    figures = picture_figures(picture, picture_to_tensor(image.picture, picture.device), perceptual)
    scores.add(image.view, "train", figures | {"hides_image": 1.0}, image.name)
    scores.hidden = (image, tensor_to_picture(picture))


def _show(
    scores: Scores,
    gaussians: Gaussians,
    rendering: Rendering,
    scene: Scene,
    messages: Mapping[str, MessageViews],
    row: int,
) -> None:
    scores.show(COVER, scene.pictures[row], rendering.pictures[COVER])
    for message in messages.values():
        scores.show(message.name, message.pictures[row], rendering.pictures[message.name])
    features = feature_map_picture(gaussians, rendering)
    if features is not None:
        scores.show(FEATURE_MAP, None, features)


def leakage_rows(scores: Scores, messages: Mapping[str, MessageViews]) -> list[MetricRow]:
    """|Correlation| of the cover's residuals on test views with each message, and the matched control."""
    rows = []
    for message in messages.values():
        index = {view: row for row, view in enumerate(message.view_names)}
        views = list(scores.residuals)
        pictures = [message.pictures[index[view]] for view in views]
        own, others = matched_correlations([scores.residuals[view] for view in views], pictures)
        for view, its_own, with_others in zip(views, own, others, strict=True):
            rows += [
                MetricRow("residual_correlation", its_own, "", view, "test", message.name, method=scores.method),
                MetricRow(
                    "residual_correlation_others", with_others, "", view, "test", message.name, method=scores.method
                ),
            ]
    return rows
