"""Watermarks detected in renders (RTWS): the paper's table, and what its PSNR alone does not show."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from stages.analysis.codec_quality import FOUND, MARKED
from stages.analysis.measurements import Measurement
from stages.analysis.method_titles import GS_HIDER
from stages.analysis.page.figures import MISSING
from stages.analysis.paper.chapter import Chapter, title_of
from stages.analysis.paper.grid import HERE, PAPER, Cell, Grid, Line, figure_cell, published_cell, some_of
from stages.analysis.paper.measuring import Measured, Spread, measure
from stages.analysis.paper.published import Published
from stages.analysis.paper.relations import Relation, TwiceCounted
from stages.analysis.paper.runs import Experiment, Run, Study, capture_title
from stages.analysis.paper.single_image import image_psnr
from stages.analysis.paper.watermark_figures import (
    EXACT,
    GRAINED,
    IMPRINTED,
    PAPERS,
    Key,
    captures_of,
    figures_by_capture,
    percent_cell,
    title_of_key,
    value_of,
    variant_of,
)
from stages.analysis.paper.watermark_survival import survival
from stages.analysis.watermark_trials import (
    BOUND,
    BOUND_AT_99,
    BOUND_BY_SCENE,
    BOUND_BY_SCENE_AT_99,
    BRIGHTNESS,
    CLEAN_CHANNEL,
    COVER_AFTER,
    COVER_BEFORE,
    COVER_CONTROL,
    DETECTED,
    DETECTED_AT_99,
    FALSE_POSITIVES,
    FALSE_POSITIVES_AT_99,
    OTHER_SCENES,
    OWN_SCENE,
    PSNR_BLACK,
    PSNR_WATERMARK,
    RENDERS,
    SCENES,
    THRESHOLD_AT_99,
    TRIALS,
)

BEFORE, CONTROL, AFTER = "before", "control", "after"
"""Beginnings of the names of stages that score containers before and after fine-tuning, and containers that were
fine-tuned as long without the watermark."""

MOST_LOST_ON_THE_COVER, MOST_LOST_ON_THE_MESSAGE, LEAST_OF_THE_WATERMARK = 0.6, 2.0, 35.0
MOST_FALSE_POSITIVES, LEAST_DETECTED = 0.1, 99.0  # percent

TO_CONTROL = "training as long without it"
AT_99 = " at 99 % detection"
BOUNDS = ((BOUND_AT_99, BOUND_BY_SCENE_AT_99, AT_99), (BOUND, BOUND_BY_SCENE, ""))
"""Quantities by picture and by scene, and the threshold that they are for."""

SAME_CONTAINER = {"clean": PAPERS}
"""Variants that differ from another only in the decoder: the image of their container is scored once."""

CONTROL_NOTE = (
    "Trained further without it: for as long as RTWS fine-tunes, on the unmarked views. What these steps gain masks "
    "what the watermark costs."
)
HELD_NOTE = (
    "The decoder itself holds the watermark: its tuning starts from the picture's own coefficients, with which even an "
    "untrained codec shows it on a plain photo at 153 dB. So this PSNR says how firmly a decoder responds to marked "
    "renders, and nothing about how much of the picture they carry."
)
OWNERS_NOTE = (
    "Grain is read by an owner who has the container from before and knows the coin tosses: the owner finds a "
    "picture's camera and tests how much better the picture follows these tosses than others. For pictures without "
    "the grain that is chance, whatever they show: the false-positive rate follows from the coins, and the bounds "
    "above, which do not use that, only reflect how many pictures were tried. A picture that shows too little of the "
    "scene for its camera to be found gives no answer."
)
IMPRINT_NOTE = (
    "Imprint: features and decoder are tuned together, through renders, until renders show the watermark and photos, "
    "renders from before and other photos do not; then the decoder alone, on whole pictures."
)
LEARNT_NOTE = (
    "No decoder has seen anything of the other scenes, neither photos nor renders: their rate of false positives is "
    "the one required. Test photos of the cover are new to decoders, too, but the scene is not; and renders from "
    "before, by new cameras, are of the very container for which decoders may have learnt to show black. Noisy photos "
    "count in neither total."
)
BOUND_NOTE = (
    "Upper bounds are one-sided, at 95 %. By picture: Clopper-Pearson, as if thousands of pictures of few scenes were "
    "independent, which they are not: every source gives the same number, so a stranger's photos and renders, which "
    "are one scene, may be most of them. By scene: the same for the number of scenes with a false positive; with S "
    "scenes and none wrong it cannot be below 1 - 0.05^(1/S), whatever is measured: 95 % for one scene, below 0.1 % "
    "only for 2,995 or more."
)
AT_99_NOTE = (
    "The usual point of a ROC curve, for undistorted renders: the threshold is what 99 % of the renders by every "
    "second new camera reach, however high that is; detected is the share of the rest, test views and new cameras, "
    "which stand between those and see nearly the same. (–: "
    "measured when all of these set the threshold, so that 99 % were detected by construction.) Distorted renders "
    "seldom reach such a threshold, and are judged by that of the other tables. A grain's owner has a separate one."
)
NOTES = {IMPRINTED: IMPRINT_NOTE, GRAINED: OWNERS_NOTE}


def rtws(study: Study, tables: Published) -> Chapter:
    """The chapter on `detect_watermark`, and on runs of stages named `before...`, `control...` and `after...`."""
    before, control, after = (_images(study.runs, word) for word in (BEFORE, CONTROL, AFTER))
    detections: dict[Key, list[Experiment]] = {}
    for each in study.experiments:
        if any(row.condition == OTHER_SCENES for row in each.rows):
            variant = variant_of(each.stage, str(each.values.get("variant", PAPERS)))
            group = detections.setdefault((each.method, variant), [])
            if not any(_measured(each) == _measured(other) for other in group):
                group.append(each)
    grids = [
        _fidelity(before, control, after, detections, tables),
        _negatives(detections),
        _at_99(detections),
        survival(detections),
        _codec(study.experiments),
    ]
    return Chapter(
        "A copyright mark read from renders",
        tuple(grid for grid in grids if grid.lines),
        tuple(_relations(before, control, after, detections, tables)),
        tuple(run for group in (before, control, after) for runs in group.values() for run in runs),
    )


def _measured(each: Experiment) -> tuple[object, ...]:
    """Identifies a measurement: rows of a workflow that differ only in what it does not depend on share one."""
    return each.capture, each.seed, each.rows


def _images(runs: Iterable[Run], word: str) -> dict[Key, list[Run]]:
    """Runs of stages whose names begin with `word`, by method and by the variant that their items state.

    They score the hidden image; `detect_watermark` scores the cover, beside the watermark.
    """
    groups: dict[Key, list[Run]] = {}
    for run in runs:
        if run.stage.startswith(word):
            stated = [value.removeprefix("variant=") for value in run.other if value.startswith("variant=")]
            variant = variant_of(run.stage, stated[0] if stated else PAPERS)
            groups.setdefault((run.method, variant), []).append(run)
    return groups


def _earlier(before: Mapping[Key, Sequence[Run]], key: Key) -> list[Run]:
    """The runs of the method, whichever variant was made from its container afterwards."""
    return [run for (method, _), runs in before.items() if method == key[0] for run in runs]


def _later(after: Mapping[Key, Sequence[Run]], key: Key) -> Sequence[Run]:
    method, variant = key
    return after.get(key) or after.get((method, SAME_CONTAINER.get(variant, variant)), ())


def _fidelity(
    before: Mapping[Key, Sequence[Run]],
    control: Mapping[Key, Sequence[Run]],
    after: Mapping[Key, Sequence[Run]],
    detections: Mapping[Key, Sequence[Experiment]],
    tables: Published,
) -> Grid:
    """PSNR_S, PSNR_M and PSNR_W, beside the paper's."""
    lines, titled, controlled = [], set(), set()
    captures = captures_of(detections)
    for key, group in detections.items():
        is_paper = key == (GS_HIDER, PAPERS)
        if key[0] not in titled:
            titled.add(key[0])
            title = f"{title_of(key[0])}, before"
            figures = (
                figures_by_capture(group, "psnr", COVER_BEFORE),
                measure(_earlier(before, key), image_psnr),
                Measured({}),
            )
            lines.append(Line((title, HERE), _decibels(figures, captures)))
            if is_paper:
                lines.append(Line((title, PAPER), _published(tables, "without"), published=True))
        cover = figures_by_capture(group, "psnr", COVER_CONTROL)
        if cover.by_capture and key[0] not in controlled:
            controlled.add(key[0])
            figures = (cover, measure(_earlier(control, key), image_psnr), Measured({}))
            lines.append(Line((f"{title_of(key[0])}, trained further without it", HERE), _decibels(figures, captures)))
        figures = (
            figures_by_capture(group, "psnr", COVER_AFTER),
            measure(_later(after, key), image_psnr),
            Measured({}) if key[1] == GRAINED else figures_by_capture(group, PSNR_WATERMARK, RENDERS),
        )
        lines.append(Line((title_of_key(key), HERE), _decibels(figures, captures)))
        if is_paper:
            lines.append(Line((title_of_key(key), PAPER), _published(tables, "with"), published=True))
    return Grid(
        "RTWS: PSNR (dB), averages over the captures",
        ("Container", "Figures"),
        ("Cover", "Image", "Watermark"),
        tuple(lines),
        (
            "Cover and watermark: test views. Image: the one view that hides it. Paper: nine captures. A watermark "
            f"that is shown exactly counts as {EXACT:g} dB. Grain carries no picture: its owner is shown the "
            "original, as bright as the detection is certain, which has no place in this column.",
            HELD_NOTE,
            *([CONTROL_NOTE] if controlled else []),
        ),
    )


def _decibels(figures: Iterable[Measured], captures: Collection[str]) -> tuple[Cell, ...]:
    return tuple(figure_cell("psnr", Spread(figure.average.mean), some_of(figure, captures)) for figure in figures)


def _published(tables: Published, row: str) -> tuple[Cell, ...]:
    figures = tables.traceable_watermark[row]
    return tuple(published_cell("psnr", figures.get(name, math.nan)) for name in ("cover", "message", "watermark"))


def _negatives(detections: Mapping[Key, Sequence[Experiment]]) -> Grid:
    """What the decoder shows for each kind of picture, and its false positives."""
    lines = []
    for key, group in detections.items():
        for experiment in group:
            kinds = dict.fromkeys(row.condition for row in experiment.rows if row.quantity == FALSE_POSITIVES)
            capture = capture_title(experiment.capture)
            shown = _shown(experiment.rows, RENDERS)
            lines.append(Line((title_of_key(key), capture, RENDERS), (*shown, *[Cell("")] * 4)))
            for kind in kinds:
                cells = (*_shown(experiment.rows, kind), *_rates(experiment.rows, kind))
                lines.append(Line((title_of_key(key), capture, kind), cells))
    return Grid(
        "What the decoder shows, and how often it is wrong",
        ("Decoder", "Capture", "Pictures"),
        (
            "vs. watermark (dB)",
            "vs. black (dB)",
            "Brightness",
            "Pictures",
            "False positives",
            "Bound, pictures",
            "Bound, scenes",
        ),
        tuple(lines),
        (
            LEARNT_NOTE,
            BOUND_NOTE,
            *(note for variant, note in NOTES.items() if any(variant == found for _, found in detections)),
        ),
    )


def _shown(rows: Sequence[Measurement], condition: str) -> tuple[Cell, ...]:
    to_watermark, to_black, brightness = (
        value_of(rows, quantity, condition) for quantity in (PSNR_WATERMARK, PSNR_BLACK, BRIGHTNESS)
    )
    return (
        figure_cell("psnr", Spread(to_watermark)),
        figure_cell("psnr", Spread(to_black)),
        figure_cell("ssim", Spread(brightness)),
    )


def _rates(rows: Sequence[Measurement], condition: str) -> tuple[Cell, ...]:
    count, scenes, wrong, bound, by_scene = (
        value_of(rows, quantity, condition) for quantity in (TRIALS, SCENES, FALSE_POSITIVES, BOUND, BOUND_BY_SCENE)
    )
    return (
        Cell(f"{count:,.0f}", f"{scenes:.0f} scenes" if scenes != 1 else "1 scene", Spread(count)),
        Cell(f"{wrong:,.0f}", "", Spread(wrong)),
        _bound(bound),
        _bound(by_scene),
    )


def _bound(bound: float) -> Cell:
    """An upper bound on a rate; `MISSING` for NaN."""
    return Cell(MISSING if math.isnan(bound) else f"{bound:.2g}", "", Spread(bound))


def _at_99(detections: Mapping[Key, Sequence[Experiment]]) -> Grid:
    """False positives in the totals at the threshold of 99 % detection, and the share of renders that reach it."""
    lines = []
    for key, group in detections.items():
        for experiment in group:
            threshold = value_of(experiment.rows, THRESHOLD_AT_99, CLEAN_CHANNEL)
            if not math.isnan(threshold):
                detected = value_of(experiment.rows, DETECTED_AT_99, CLEAN_CHANNEL)
                cells = [Cell(f"{threshold:.4f}", "", Spread(threshold)), percent_cell(detected)]
                for condition in (OTHER_SCENES, OWN_SCENE):
                    cells += _rates_at_99(experiment.rows, condition)
                lines.append(Line((title_of_key(key), capture_title(experiment.capture)), tuple(cells)))
    return Grid(
        "At 99 % detection of clean renders",
        ("Decoder", "Capture"),
        (
            "Threshold",
            "Renders detected",
            "Other scenes: false positives",
            "Other scenes: bound, pictures",
            "Other scenes: bound, scenes",
            "The cover without it: false positives",
            "The cover: bound, pictures",
            "The cover: bound, scenes",
        ),
        tuple(lines),
        (AT_99_NOTE, BOUND_NOTE),
    )


def _rates_at_99(rows: Sequence[Measurement], condition: str) -> Iterator[Cell]:
    count, wrong, bound, by_scene = (
        value_of(rows, quantity, condition)
        for quantity in (TRIALS, FALSE_POSITIVES_AT_99, BOUND_AT_99, BOUND_BY_SCENE_AT_99)
    )
    yield Cell(f"{wrong:,.0f}", f"of {count:,.0f}", Spread(wrong))
    yield from (_bound(bound), _bound(by_scene))


def _codec(experiments: Iterable[Experiment]) -> Grid:
    """The codec's own quality, as `train_codec` measured it."""
    rows = list(dict.fromkeys(row for each in experiments for row in each.rows if row.quantity in (MARKED, FOUND)))
    lines = [
        Line(
            (condition,),
            tuple(figure_cell("psnr", Spread(value_of(rows, name, condition))) for name in (MARKED, FOUND)),
        )
        for condition in dict.fromkeys(row.condition for row in rows)
    ]
    return Grid(
        "The codec by itself, on held-out photos: PSNR (dB)",
        ("Hidden in",),
        ("Watermarked picture", "Watermark, from 8 bits"),
        tuple(lines),
    )


def _relations(
    before: Mapping[Key, Sequence[Run]],
    control: Mapping[Key, Sequence[Run]],
    after: Mapping[Key, Sequence[Run]],
    detections: Mapping[Key, Sequence[Experiment]],
    tables: Published,
) -> Iterator[Relation]:
    """The requirements of this project; the paper gives no false positives."""
    paper = tables.traceable_watermark
    for key, group in detections.items():
        title, is_paper = title_of_key(key), key == (GS_HIDER, PAPERS)
        for runs, condition, to in ((before, COVER_BEFORE, "before"), (control, COVER_CONTROL, TO_CONTROL)):
            covers = figures_by_capture(group, "psnr", condition)
            if not covers.by_capture:
                continue
            losses = {
                "cover": figures_by_capture(group, "psnr", COVER_AFTER).minus(covers),
                "message": measure(_later(after, key), image_psnr).minus(measure(_earlier(runs, key), image_psnr)),
            }
            for picture, most in (("cover", MOST_LOST_ON_THE_COVER), ("message", MOST_LOST_ON_THE_MESSAGE)):
                if losses[picture].by_capture:
                    is_published = is_paper and condition == COVER_BEFORE
                    published = paper["with"][picture] - paper["without"][picture] if is_published else math.nan
                    text = f"{title}: {picture}, vs. {to}"
                    yield Relation(text, "difference", "at least", -most, losses[picture], published)
        if key[1] != GRAINED:
            published = paper["with"]["watermark"] if is_paper else math.nan
            shown = figures_by_capture(group, PSNR_WATERMARK, RENDERS)
            yield Relation(f"{title}: watermark", "figure", "at least", LEAST_OF_THE_WATERMARK, shown, published)
        for quantity, where in ((DETECTED, ""), (DETECTED_AT_99, AT_99)):
            detected = _percents(group, quantity, CLEAN_CHANNEL)
            if detected.by_capture:
                text = f"{title}: renders detected{where}, in %"
                yield Relation(text, "ratio", "at least", LEAST_DETECTED, detected)
        for by_picture, by_scene, where in BOUNDS:
            for condition, of in ((OTHER_SCENES, "other scenes"), (OWN_SCENE, "the cover without it")):
                bound, of_scenes = (_percents(group, quantity, condition) for quantity in (by_picture, by_scene))
                if bound.by_capture:
                    text = f"{title}: upper bound on false positives{where}, {of}, in %"
                    yield TwiceCounted(text, "ratio", "less than", MOST_FALSE_POSITIVES, bound, by_scene=of_scenes)


def _percents(detections: Iterable[Experiment], quantity: str, condition: str) -> Measured:
    found = figures_by_capture(detections, quantity, condition)
    return Measured({capture: Spread(100 * each.mean) for capture, each in found.by_capture.items()})
