"""What was measured: a run for each training that was scored or timed, told apart by what its item says of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from pipeline.errors import UserError
from pipeline.stage import Item
from stages.analysis.measurements import Measurement, read_measurements
from stages.analysis.page.material import METHOD_TITLES, OURS, PLAIN
from stages.analysis.paper.telling import Told, others, telling, told
from stages.analysis.probes import probed
from stages.hiding.methods.homogeneous import PRESETS, SCENE_PRESETS
from stages.imaging.metric_table import MetricRow, read_rows

SETTINGS = {
    "lambda_message": "λ = {}",
    "feature_dim": "M = {}",
    "layers": "{} layers",
    "decoder_width": "decoders {} wide",
    "iterations": "{} iterations",
    "gaussians": "at most {} Gaussians",
    "sealed": "sealed",
}
"""Columns of items that tell runs of one method apart, and how a line of a table is called after them."""

SETTINGS_OF_PLAIN = ("iterations", "gaussians")
"""Plain 3DGS has no setting of hiding."""

DECODER_WIDTH = 64.0
"""The usual width of decoders, in channels, which the paper does not say."""

Settings = tuple[tuple[str, float | str], ...]


@dataclass(frozen=True)
class Columns:
    """Which columns of the items name the capture, the method and the seed."""

    capture: str = "capture"
    method: str = "method"
    seed: str = "seed"


@dataclass(frozen=True)
class Run:
    """One training, as scored or as timed.

    `settings` are those that its item states and that are not the usual ones, in the order of `SETTINGS`, and then such
    values as alone tell it from another run (`telling`); `other` is whatever else the item states, such as the message:
    runs that differ in their seed alone have the same. `stage` is the name, in the workflow, of the stage that measured
    it, `digest` that of the artifact that says what it measured.
    """

    capture: str
    method: str
    settings: Settings
    seed: str
    rows: tuple[MetricRow, ...] = field(repr=False)
    other: tuple[str, ...] = ()
    stage: str = ""
    digest: str = field(default="", repr=False)

    @property
    def messages(self) -> tuple[str, ...]:
        """The messages that were scored, in the order of their first row."""
        return tuple(dict.fromkeys(row.message for row in self.rows if row.message is not None))

    @property
    def hides_image(self) -> bool:
        """Whether the message is an image that one view hides."""
        return bool(self.hiding_views)

    @property
    def hiding_views(self) -> frozenset[str | None]:
        """The views that hide an image."""
        return frozenset(row.view for row in self.rows if row.quantity == "hides_image" and row.value > 0)

    @property
    def kind(self) -> tuple[str, Settings, tuple[str, ...] | int]:
        """What runs have in common that differ in capture and seed alone: an image is known by its name."""
        return self.method, self.settings, self.messages if self.hides_image else len(self.messages)


@dataclass(frozen=True)
class Experiment:
    """What one item measured under conditions, such as attacks: `capture`, `method`, `settings`, `seed` and `stage` as
    in `Run`, `values` whatever its item states.
    """

    capture: str
    method: str
    seed: str
    rows: tuple[Measurement, ...] = field(repr=False)
    values: Mapping[str, object] = field(repr=False)
    stage: str = ""
    settings: Settings = ()


@dataclass(frozen=True)
class Study:
    """Everything that the tables are made of; `failures` are items that were not made, each with its cause.

    `iterations` are the usual ones: the fewest that any item states, so that longer runs show how near these are to
    their plateau; None where no item states any. `sources` are the names in the workflow, each with the digest of its
    artifact, of all that any of it was read from.
    """

    runs: tuple[Run, ...]
    timings: tuple[Run, ...] = ()
    failures: tuple[tuple[str, str], ...] = ()
    iterations: float | None = None
    experiments: tuple[Experiment, ...] = ()
    sources: tuple[tuple[str, str], ...] = ()

    @property
    def captures(self) -> tuple[str, ...]:
        """The captures in the order of their first run."""
        measured: list[Run | Experiment] = [*self.runs, *self.timings, *self.experiments]
        return tuple(dict.fromkeys(each.capture for each in measured))

    def select(self, wanted: Callable[[Run], bool]) -> tuple[Run, ...]:
        """The scored runs that `wanted` is true of, in order."""
        return tuple(run for run in self.runs if wanted(run))


def read_study(
    scores: Iterable[Item],
    timings: Iterable[Item],
    columns: Columns,
    setup: Mapping[str, float],
    experiments: Iterable[Item] = (),
) -> Study:
    """The runs and experiments behind labelled items; `setup` holds the usual settings, those of the paper.

    Of the bound on Gaussians the usual one is the largest that items of the same capture state.

    A training that was scored several times, such as the plain 3DGS beside every method, counts once.
    Raises UserError where some items lack the column of captures that others have.
    """
    scores, timings, experiments = tuple(scores), tuple(timings), tuple(experiments)
    items = (*scores, *timings, *experiments)
    _check_captures(items, columns)
    iterations = min(_stated(items, "iterations"), default=None)
    usual = {**setup, **({"iterations": iterations} if iterations is not None else {})}

    def usual_of(item: Item) -> Mapping[str, float]:
        alike = [each for each in items if each.values.get(columns.capture) == item.values.get(columns.capture)]
        bounds = _stated(alike, "gaussians")
        return {**usual, **({"gaussians": max(bounds)} if bounds else {})}

    scored = _distinct(run for item in scores for run in _runs_of(item, columns, usual_of(item)))
    timed = _distinct(run for item in timings for run in _runs_of(item, columns, usual_of(item)))
    names = _telling(timed) | _telling(scored)  # times name no message, so that less tells them apart
    tried = [experiment for item in experiments for experiment in _experiments_of(item, columns, usual_of(item))]
    return Study(
        tuple(_with_settings(run, names[run.method]) for run in scored),
        tuple(_with_settings(run, names[run.method]) for run in timed),
        tuple((item.label, item.cause or "not made") for item in items if item.artifact is None),
        iterations,
        _told_apart(tried, columns),
        tuple(dict.fromkeys((item.stage, item.artifact.digest) for item in items if item.artifact is not None)),
    )


def _stated(items: Iterable[Item], name: str) -> list[float]:
    """The numbers that items state of a setting."""
    values = [_value(item.values[name]) for item in items if item.values.get(name) is not None]
    return [value for value in values if isinstance(value, float)]


def by_kind(runs: Iterable[Run]) -> dict[tuple[object, ...], tuple[Run, ...]]:
    """Runs that differ in capture and seed alone, together: methods in the paper's order, others after them."""
    order = list(METHOD_TITLES)
    groups: dict[tuple[object, ...], list[Run]] = {}
    for run in sorted(runs, key=lambda run: order.index(run.method) if run.method in order else len(order)):
        groups.setdefault(run.kind, []).append(run)
    return {kind: tuple(group) for kind, group in groups.items()}


def by_method(experiments: Iterable[Experiment]) -> dict[str, tuple[Experiment, ...]]:
    """Experiments that differ in capture and seed alone, together: methods in the paper's order, others after them.

    The key is the method where its settings are the usual ones, or all that there are of it; of others it is the title,
    so that a container with another λ is not taken for one more seed.
    """
    listed = list(experiments)
    order = [*METHOD_TITLES, *sorted({each.method for each in listed} - METHOD_TITLES.keys())]
    groups: dict[str, list[Experiment]] = {}
    for method in order:
        own = [each for each in listed if each.method == method]
        kinds = sorted({each.settings for each in own}, key=lambda settings: (bool(settings), str(settings)))
        for settings in kinds:
            is_usual = not settings or len(kinds) == 1
            key = method if is_usual else settings_title(method, settings)
            groups[key] = [each for each in own if each.settings == settings]
    return {key: tuple(group) for key, group in groups.items()}


def method_title(run: Run) -> str:
    """The method's title, with each setting that is not the usual one.

    >>> method_title(Run("fox", "gs_hider", (("feature_dim", 32.0),), "0", ()))
    'GS-Hider, M = 32'
    """
    return settings_title(run.method, run.settings)


def settings_title(method: str, settings: Settings) -> str:
    """The method's title, with settings."""
    title = METHOD_TITLES.get(method, method)
    return ", ".join([title, *(_title_of_setting(name).format(_written(value)) for name, value in settings)])


def _title_of_setting(name: str) -> str:
    return SETTINGS.get(name, f"{name.split('.')[-1].replace('_', ' ')} {{}}")


def capture_title(capture: str) -> str:
    """The last part of a capture's name, which may be a path."""
    return Path(capture).name or "Capture"


def _written(value: float | str) -> str:
    return f"{value:,g}" if isinstance(value, float) else str(value)


def _runs_of(item: Item, columns: Columns, usual: Mapping[str, float]) -> list[Run]:
    if item.artifact is None:
        return []
    rows = read_rows(item.artifact)
    stated = item.values.get(columns.method)
    first = str(stated) if stated is not None else next((row.method for row in rows if row.method), PLAIN)
    by_method: dict[str, list[MetricRow]] = {}
    for row in rows:
        method = row.method or first
        if method != PLAIN or row.message is None:  # of plain 3DGS, messages are only a control
            by_method.setdefault(method, []).append(row)
    capture, seed = (item.values.get(column) for column in (columns.capture, columns.seed))
    other = tuple(f"{name}={value}" for name, value in sorted(others(item.values, _known(columns)).items()))
    return [
        Run(
            "" if capture is None else str(capture),
            method,
            _settings(item, method, _usual_of_pictures(group, usual_settings(method, usual))),
            "" if seed is None else str(seed),
            tuple(group),
            other if method != PLAIN else (),
            item.stage,
            item.artifact.digest,
        )
        for method, group in by_method.items()
    ]


def _experiments_of(item: Item, columns: Columns, usual: Mapping[str, float]) -> list[Experiment]:
    """One for each method that the rows name."""
    if item.artifact is None:
        return []
    by_method: dict[str, list[Measurement]] = {}
    for row in read_measurements(item.artifact):
        by_method.setdefault(row.method or str(item.values.get(columns.method, "")), []).append(row)
    capture, seed = (item.values.get(column) for column in (columns.capture, columns.seed))
    return [
        Experiment(
            "" if capture is None else str(capture),
            method,
            "" if seed is None else str(seed),
            tuple(rows),
            item.values,
            item.stage,
            _settings(item, method, usual_settings(method, usual)),
        )
        for method, rows in by_method.items()
    ]


def usual_settings(method: str, setup: Mapping[str, float]) -> Mapping[str, float]:
    """A method's usual settings, also of its probes: those of the paper, and what our own takes by itself."""
    probe = probed(method)
    own = {**PRESETS, **SCENE_PRESETS} if (probe[0] if probe else method) == OURS else {}
    return {**setup, "decoder_width": DECODER_WIDTH, **{name: own[name] for name in SETTINGS if name in own}}


def _usual_of_pictures(rows: Sequence[MetricRow], usual: Mapping[str, float]) -> Mapping[str, float]:
    """A hidden image has a λ of its own."""
    hides_image = any(row.quantity == "hides_image" for row in rows)
    return {**usual, "lambda_message": usual["lambda_image"]} if hides_image else usual


def _settings(item: Item, method: str, usual: Mapping[str, float]) -> Settings:
    """What is stated and unusual; whatever is stated where nothing says what is usual."""
    names = list(SETTINGS) if method != PLAIN else SETTINGS_OF_PLAIN
    given = {name: item.values.get(name) for name in names}
    stated = {name: _value(value) for name, value in given.items() if value is not None and value is not False}
    return tuple((name, value) for name, value in stated.items() if value != usual.get(name))


def _value(value: object) -> float | str:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def _distinct(runs: Iterable[Run]) -> tuple[Run, ...]:
    """Each run once: one whose rows another of the same kind and capture has, too, is the same training again."""
    kept: list[Run] = []
    for run in runs:
        alike = [
            other
            for other in kept
            if (other.capture, other.method, other.settings) == (run.capture, run.method, run.settings)
        ]
        if any(_scored(run) <= _scored(other) for other in alike):
            continue
        kept = [other for other in kept if other not in alike or not _scored(other) <= _scored(run)]
        kept.append(run)
    return tuple(kept)


def _known(columns: Columns) -> set[str]:
    return {columns.capture, columns.method, columns.seed, *SETTINGS}


def _telling(runs: Sequence[Run]) -> dict[str, set[str]]:
    """By method, what tells runs apart that differ in nothing else."""
    return telling((run.method, (run.capture, run.kind, run.seed), told(_stated_by(run))) for run in runs)


def _stated_by(run: Run) -> dict[str, str]:
    return dict(text.split("=", 1) for text in run.other)


def _with_settings(run: Run, names: set[str]) -> Run:
    """With these of what else its item states among its settings."""
    other = tuple(text for text in run.other if text.split("=", 1)[0] not in names)
    return replace(run, settings=(*run.settings, *_among(told(_stated_by(run)), names)), other=other)


def _told_apart(experiments: Sequence[Experiment], columns: Columns) -> tuple[Experiment, ...]:
    """The experiments, with what tells them apart among their settings.

    Those of several stages are different measurements of one container.
    """
    stated = [told(others(each.values, _known(columns))) for each in experiments]
    names = telling(
        (each.method, (each.stage, each.capture, each.settings, each.seed), own)
        for each, own in zip(experiments, stated, strict=True)
    )
    return tuple(
        replace(each, settings=(*each.settings, *_among(own, names[each.method])))
        for each, own in zip(experiments, stated, strict=True)
    )


def _among(stated: Told, names: set[str]) -> Settings:
    return tuple((name, value) for name, value in stated.items() if name in names)


def _scored(run: Run) -> set[tuple[MetricRow, bool]]:
    """Its rows, and whether they were measured: NaN alone is not equal to itself."""
    return {(replace(row, value=0.0), False) if math.isnan(row.value) else (row, True) for row in run.rows}


def _check_captures(items: Sequence[Item], columns: Columns) -> None:
    without = [item.label for item in items if columns.capture not in item.values]
    if without and len(without) < len(items):
        raise UserError(
            "some items do not say what capture they are of",
            where=", ".join(without),
            expected=f"a column {columns.capture!r}, which the other items have",
            remedy="Add it to the foreach of these items, or name another column with capture_column.",
        )
