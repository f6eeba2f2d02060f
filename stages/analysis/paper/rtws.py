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
from stages.analysis.paper.measuring import Measured, Spread
from stages.analysis.paper.published import Published
from stages.analysis.paper.rtws_relations import relations
from stages.analysis.paper.runs import Experiment, Study, capture_title
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
)
from stages.analysis.paper.watermark_survival import survival
from stages.analysis.paper.watermarked import Watermarked, watermarked
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

COLUMNS_NOTE = (
    "Cover and watermark: test views. Image: the one view that hides it. Paper: nine captures. A watermark that is "
    f"shown exactly counts as {EXACT:g} dB. Grain carries no picture: its owner is shown the original, as bright as "
    "the detection is certain, which has no place in this column."
)
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
    """The chapter on what `detect_watermark` measured, and on containers before and after fine-tuning."""
    found = watermarked(study)
    grids = [
        _fidelity(found, tables),
        _negatives(found.detections),
        _at_99(found.detections),
        survival(found.detections),
        _codec(study.experiments),
    ]
    return Chapter(
        "A copyright mark read from renders",
        tuple(grid for grid in grids if grid.lines),
        tuple(relations(found, tables)),
        found.runs,
    )


def _fidelity(found: Watermarked, tables: Published) -> Grid:
    """PSNR_S, PSNR_M and PSNR_W, beside the paper's."""
    lines, methods, controlled = list[Line](), set(), set()
    captures = captures_of(found.detections)
    for key in found.detections:
        method, is_paper = key[0], key == (GS_HIDER, PAPERS)
        if method not in methods:
            methods.add(method)
            lines += _before(found, key, captures, tables if is_paper else None)
        cover = figures_by_capture(found.detections[key], "psnr", COVER_CONTROL)
        if cover.by_capture and method not in controlled:
            controlled.add(method)
            figures = (cover, found.image_of_control(key), Measured({}))
            lines.append(Line((f"{title_of(method)}, trained further without it", HERE), _decibels(figures, captures)))
        lines += _after(found, key, captures, tables if is_paper else None)
    return Grid(
        "RTWS: PSNR (dB), averages over the captures",
        ("Container", "Figures"),
        ("Cover", "Image", "Watermark"),
        tuple(lines),
        (COLUMNS_NOTE, HELD_NOTE, *([CONTROL_NOTE] if controlled else [])),
    )


def _before(found: Watermarked, key: Key, captures: Collection[str], tables: Published | None) -> Iterator[Line]:
    """A method's containers before the watermark, here and, with `tables`, in the paper."""
    title = f"{title_of(key[0])}, before"
    cover = figures_by_capture(found.detections[key], "psnr", COVER_BEFORE)
    yield Line((title, HERE), _decibels((cover, found.image_before(key), Measured({})), captures))
    if tables is not None:
        yield Line((title, PAPER), _published(tables, "without"), published=True)


def _after(found: Watermarked, key: Key, captures: Collection[str], tables: Published | None) -> Iterator[Line]:
    """The same with the watermark."""
    group = found.detections[key]
    cover = figures_by_capture(group, "psnr", COVER_AFTER)
    watermark = Measured({}) if key[1] == GRAINED else figures_by_capture(group, PSNR_WATERMARK, RENDERS)
    yield Line((title_of_key(key), HERE), _decibels((cover, found.image_after(key), watermark), captures))
    if tables is not None:
        yield Line((title_of_key(key), PAPER), _published(tables, "with"), published=True)


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
