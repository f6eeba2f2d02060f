"""The runs and measurements of watermarked containers, grouped by method and variant."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from stages.analysis.paper.measuring import Measured, measure
from stages.analysis.paper.runs import Experiment, Run, Study
from stages.analysis.paper.single_image import image_psnr
from stages.analysis.paper.watermark_figures import PAPERS, Key, variant_of
from stages.analysis.watermark_trials import OTHER_SCENES

BEFORE, CONTROL, AFTER = "before", "control", "after"
"""Beginnings of the names of stages that score containers before and after fine-tuning, and containers that were
fine-tuned as long without the watermark."""

SAME_CONTAINER = {"clean": PAPERS}
"""Variants that differ from another only in the decoder: the image of their container is scored once."""


@dataclass(frozen=True)
class Watermarked:
    """Runs that score the hidden image `before`, as `control` and `after`; `detections` score covers and watermarks."""

    before: Mapping[Key, Sequence[Run]]
    control: Mapping[Key, Sequence[Run]]
    after: Mapping[Key, Sequence[Run]]
    detections: Mapping[Key, Sequence[Experiment]]

    @property
    def runs(self) -> tuple[Run, ...]:
        """All runs."""
        return tuple(
            run for group in (self.before, self.control, self.after) for runs in group.values() for run in runs
        )

    def image_before(self, key: Key) -> Measured:
        """PSNR of the hidden image before the watermark, by capture."""
        return measure(_of_method(self.before, key), image_psnr)

    def image_of_control(self, key: Key) -> Measured:
        """The same after as many steps without the watermark; empty if there is no such container."""
        return measure(_of_method(self.control, key), image_psnr)

    def image_after(self, key: Key) -> Measured:
        """The same with the watermark."""
        method, variant = key
        same = (method, SAME_CONTAINER.get(variant, variant))
        return measure(self.after.get(key) or self.after.get(same, ()), image_psnr)


def watermarked(study: Study) -> Watermarked:
    """What `detect_watermark` measured, and the runs of stages named `before...`, `control...` and `after...`.

    Rows of a workflow that differ only in what a measurement does not depend on share one, which counts once.
    """
    detections: dict[Key, list[Experiment]] = {}
    for each in study.experiments:
        if any(row.condition == OTHER_SCENES for row in each.rows):
            variant = variant_of(each.stage, str(each.values.get("variant", PAPERS)))
            group = detections.setdefault((each.method, variant), [])
            if not any(_measured(each) == _measured(other) for other in group):
                group.append(each)
    before, control, after = (_by_key(study.runs, word) for word in (BEFORE, CONTROL, AFTER))
    return Watermarked(before, control, after, detections)


def _measured(each: Experiment) -> tuple[object, ...]:
    return each.capture, each.seed, each.rows


def _by_key(runs: Iterable[Run], word: str) -> dict[Key, list[Run]]:
    """Runs of stages whose names begin with `word`, by method and by the variant that their items state."""
    groups: dict[Key, list[Run]] = {}
    for run in runs:
        if run.stage.startswith(word):
            stated = [value.removeprefix("variant=") for value in run.other if value.startswith("variant=")]
            variant = variant_of(run.stage, stated[0] if stated else PAPERS)
            groups.setdefault((run.method, variant), []).append(run)
    return groups


def _of_method(groups: Mapping[Key, Sequence[Run]], key: Key) -> list[Run]:
    """The runs of the method, whichever variant was made from its container afterwards."""
    return [run for (method, _), runs in groups.items() if method == key[0] for run in runs]
