"""What is required of watermarks in renders (RTWS); the paper gives no false positives."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

from stages.analysis.method_titles import GS_HIDER
from stages.analysis.paper.measuring import Measured, Spread
from stages.analysis.paper.published import Figures, Published
from stages.analysis.paper.relations import Relation, TwiceCounted
from stages.analysis.paper.runs import Experiment
from stages.analysis.paper.watermark_figures import GRAINED, PAPERS, Key, figures_by_capture, title_of_key
from stages.analysis.paper.watermarked import Watermarked
from stages.analysis.watermark_trials import (
    BOUND,
    BOUND_AT_99,
    BOUND_BY_SCENE,
    BOUND_BY_SCENE_AT_99,
    CLEAN_CHANNEL,
    COVER_AFTER,
    COVER_BEFORE,
    COVER_CONTROL,
    DETECTED,
    DETECTED_AT_99,
    OTHER_SCENES,
    OWN_SCENE,
    PSNR_WATERMARK,
    RENDERS,
)

MOST_LOST_ON_THE_COVER, MOST_LOST_ON_THE_MESSAGE, LEAST_OF_THE_WATERMARK = 0.6, 2.0, 35.0
MOST_FALSE_POSITIVES, LEAST_DETECTED = 0.1, 99.0  # percent

TO_CONTROL = "training as long without it"
AT_99 = " at 99 % detection"
BOUNDS = ((BOUND_AT_99, BOUND_BY_SCENE_AT_99, AT_99), (BOUND, BOUND_BY_SCENE, ""))
"""Quantities by picture and by scene, and the threshold that they are for."""


def relations(found: Watermarked, tables: Published) -> Iterator[Relation]:
    """What each watermark costs, how firmly its decoder shows it, and how often the decoder is right and wrong."""
    for key, group in found.detections.items():
        title, paper = title_of_key(key), tables.traceable_watermark if key == (GS_HIDER, PAPERS) else None
        yield from _losses(found, key, paper)
        if key[1] != GRAINED:
            shown = figures_by_capture(group, PSNR_WATERMARK, RENDERS)
            published = paper["with"]["watermark"] if paper else math.nan
            yield Relation(f"{title}: watermark", "figure", "at least", LEAST_OF_THE_WATERMARK, shown, published)
        yield from _detected(title, group)
        yield from _false_positives(title, group)


def _losses(found: Watermarked, key: Key, paper: Mapping[str, Figures] | None) -> Iterator[Relation]:
    """What the watermark costs the cover and the message, also beside as many steps without it."""
    cover, message = (figures_by_capture(found.detections[key], "psnr", COVER_AFTER), found.image_after(key))
    for condition, image, to in (
        (COVER_BEFORE, found.image_before(key), "before"),
        (COVER_CONTROL, found.image_of_control(key), TO_CONTROL),
    ):
        reference = figures_by_capture(found.detections[key], "psnr", condition)
        if not reference.by_capture:
            continue
        for picture, lost, most in (
            ("cover", cover.minus(reference), MOST_LOST_ON_THE_COVER),
            ("message", message.minus(image), MOST_LOST_ON_THE_MESSAGE),
        ):
            if lost.by_capture:
                published = math.nan
                if paper is not None and condition == COVER_BEFORE:
                    published = paper["with"][picture] - paper["without"][picture]
                text = f"{title_of_key(key)}: {picture}, vs. {to}"
                yield Relation(text, "difference", "at least", -most, lost, published)


def _detected(title: str, group: Sequence[Experiment]) -> Iterator[Relation]:
    for quantity, where in ((DETECTED, ""), (DETECTED_AT_99, AT_99)):
        detected = _percents(group, quantity, CLEAN_CHANNEL)
        if detected.by_capture:
            text = f"{title}: renders detected{where}, in %"
            yield Relation(text, "ratio", "at least", LEAST_DETECTED, detected)


def _false_positives(title: str, group: Sequence[Experiment]) -> Iterator[Relation]:
    for by_picture, by_scene, where in BOUNDS:
        for condition, of in ((OTHER_SCENES, "other scenes"), (OWN_SCENE, "the cover without it")):
            bound, of_scenes = (_percents(group, quantity, condition) for quantity in (by_picture, by_scene))
            if bound.by_capture:
                text = f"{title}: upper bound on false positives{where}, {of}, in %"
                yield TwiceCounted(text, "ratio", "less than", MOST_FALSE_POSITIVES, bound, by_scene=of_scenes)


def _percents(detections: Iterable[Experiment], quantity: str, condition: str) -> Measured:
    found = figures_by_capture(detections, quantity, condition)
    return Measured({capture: Spread(100 * each.mean) for capture, each in found.by_capture.items()})
