"""Leave one scene out: a learned detector is trained on renders of the others, and looks at those of this one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import torch

from stages.analysis.measurements import Measurement
from stages.analysis.picture_classes import CLEAN, HIDDEN
from stages.analysis.renders import Renders
from stages.analysis.residual_detector import detector_scores, train_detector, views_of
from stages.analysis.stored_views import Views

LEARNED = {"learned_on_renders": "renders", "learned_on_feature_maps": "feature maps"}
"""Quantities, each a detector's logit, and what that detector looks at."""

TRAINING_SCENES = "training_scenes"
"""From how many scenes the detectors learnt, of one capture each."""

TRAINING_PAIRS = "training_pairs"
"""From how many containers, each with a clean training: more than scenes where some differ in seed or message alone."""

Classes = Mapping[str, Renders]
"""One scene's renders by their class; HIDDEN and CLEAN are among them."""


def detection_rows(
    tested: Sequence[Classes],
    others: Sequence[tuple[str, Classes]],
    method: str,
    seed: int,
    iterations: int,
    after_each: Callable[[float], None] = lambda share: None,
    device: torch.device | str = "cpu",
) -> Iterator[Measurement]:
    """The logit of every view of the tested scene, on renders and, where there are any, on feature maps.

    `tested` are its trainings: one as a rule, and the number of each is the `seed` of its rows. `others` are trainings
    of other scenes, each beside its capture's name. Nothing without any tested, no logits without others. `after_each`
    is told the share of the work that is done. Detectors are on `device`.
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
