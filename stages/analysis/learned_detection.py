"""Leave-one-scene-out evaluation: a learned detector is trained on renders of all scenes but the tested one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import torch

from stages.analysis.measurements import Measurement
from stages.analysis.picture_classes import CLEAN, HIDDEN
from stages.analysis.renders import Renders
from stages.analysis.residual_detector import detector_scores, train_detector, views_of
from stages.analysis.stored_views import Views

LEARNED = {"learned_on_renders": "renders", "learned_on_feature_maps": "feature maps"}
"""The quantities, logits of one detector each, and what that detector sees."""

TRAINING_SCENES = "training_scenes"
"""Quantity: how many scenes, each a capture of its own, the detectors were trained on."""

TRAINING_PAIRS = "training_pairs"
"""Quantity: how many containers, each with its clean counterpart, the detectors were trained on.

More than scenes if some differ only in seed or message.
"""

Classes = Mapping[str, Renders]
"""Renders of one scene by class; HIDDEN and CLEAN are among the classes."""


def detection_rows(
    tested: Sequence[Classes],
    others: Sequence[tuple[str, Classes]],
    method: str,
    seed: int,
    iterations: int,
    after_each: Callable[[float], None] = lambda share: None,
    device: torch.device | str = "cpu",
) -> Iterator[Measurement]:
    """The detector's logit for every view of the tested scene, on renders and, if all others have them, feature maps.

    `tested` are the trainings of that scene, usually one; each one's position is the `seed` of its rows. `others` are
    trainings of other scenes, each with the name of its capture. Yields nothing if `tested` is empty, and no logits if
    `others` is. `after_each` receives the share of the work done. Detectors run on `device`.
    """
    if tested:
        yield Measurement(TRAINING_SCENES, len({capture for capture, _ in others}), HIDDEN, method=method)
        yield Measurement(TRAINING_PAIRS, len(others), HIDDEN, method=method)
    if not tested or not others:
        return
    for number, (quantity, views_in) in enumerate(VIEWS.items()):

        def progress(iteration: int, before: int = number) -> None:
            after_each((before + iteration / iterations) / len(VIEWS))

        pairs = [[views_in(scene[condition])[1] for condition in (HIDDEN, CLEAN)] for _, scene in others]
        if not all(len(values) for pair in pairs for values in pair):
            continue
        scenes = [(views_of(hidden), views_of(clean)) for hidden, clean in pairs]
        detector = train_detector(scenes, seed, iterations, after_each=progress, device=device)
        for training, classes in enumerate(tested):
            for condition, renders in classes.items():
                names, values = views_in(renders)
                for name, logit in zip(names, detector_scores(detector, views_of(values)), strict=True):
                    yield Measurement(quantity, logit, condition, seed=training, view=name, method=method)


def _pictures(renders: Renders) -> tuple[tuple[str, ...], Views]:
    return renders.view_names, renders.pictures


def _feature_maps(renders: Renders) -> tuple[tuple[str, ...], Views]:
    return renders.feature_map_names, renders.feature_maps


VIEWS: Mapping[str, Callable[[Renders], tuple[tuple[str, ...], Views]]] = dict(
    zip(LEARNED, (_pictures, _feature_maps), strict=True)
)
