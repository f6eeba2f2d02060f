"""What was measured: a run for each training that was scored or timed, identified by what its item states."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from pipeline.errors import UserError
from pipeline.stage import Item
from stages.analysis.measurements import Measurement, read_measurements
from stages.analysis.method_titles import METHOD_TITLES
from stages.analysis.paper.settings import (
    SETTINGS,
    Settings,
    number_or_text,
    settings_title,
    stated_settings,
    usual_of_pictures,
    usual_settings,
)
from stages.analysis.paper.telling import PossibleSettings, others, possible_settings, telling
from stages.hiding.method_names import PLAIN
from stages.imaging.metric_table import MetricRow, read_rows


@dataclass(frozen=True)
class Columns:
    """The item columns that name the capture, the method, the seed and the scene that is hidden."""

    capture: str = "capture"
    method: str = "method"
    seed: str = "seed"
    message: str = "message"


@dataclass(frozen=True)
class Run:
    """One training, as scored or as timed.

    `settings` are those that its item states and that are not the usual ones, in the order of `SETTINGS`, and then
    other values that alone distinguish it from another run (`telling`). `other` is everything else that the item
    states, such as the message; runs that differ only in their seed have the same. `stage` names the stage in the
    workflow that measured it, `digest` is that of the artifact with its rows. `hidden` names the scene that its item
    says is hidden; empty if the item does not say.
    """

    capture: str
    method: str
    settings: Settings
    seed: str
    rows: tuple[MetricRow, ...] = field(repr=False)
    other: tuple[str, ...] = ()
    stage: str = ""
    digest: str = field(default="", repr=False)
    hidden: str = ""

    @property
    def messages(self) -> tuple[str, ...]:
        """The messages that were scored, in the order of their first row."""
        return tuple(dict.fromkeys(row.message for row in self.rows if row.message is not None))

    @property
    def hides(self) -> str:
        """What is hidden, by which runs of other methods are paired with this one; empty if unknown, or nothing is."""
        return self.hidden or ", ".join(self.messages)

    @property
    def hides_image(self) -> bool:
        """Whether the message is an image hidden in one view."""
        return bool(self.hiding_views)

    @property
    def hiding_views(self) -> frozenset[str | None]:
        """The views that hide an image."""
        return frozenset(row.view for row in self.rows if row.quantity == "hides_image" and row.value > 0)

    @property
    def kind(self) -> tuple[str, Settings, tuple[str, ...] | int]:
        """What runs that differ only in capture and seed have in common; images count by name, scenes by number."""
        return self.method, self.settings, self.messages if self.hides_image else len(self.messages)


@dataclass(frozen=True)
class Experiment:
    """What one item measured under conditions, such as attacks.

    `capture`, `method`, `settings`, `seed` and `stage` are as in `Run`; `values` is all that its item states.
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

    `iterations` is the usual number: the fewest that any item states, so that longer runs show how near these are to
    their plateau; None if no item states any. `sources` has the name in the workflow and the digest of each artifact
    that was read.
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
        """The scored runs for which `wanted` is true, in order."""
        return tuple(run for run in self.runs if wanted(run))


def read_study(
    scores: Iterable[Item],
    timings: Iterable[Item],
    columns: Columns,
    setup: Mapping[str, float],
    experiments: Iterable[Item] = (),
) -> Study:
    """The runs and experiments of labelled items; `setup` holds the usual settings, those of the paper.

    The usual bound on Gaussians is the largest that items of the same capture state. The usual width of the decoders of
    a method of one's own, which may have none, is the one that all of its items state. A training that was scored
    several times, such as the plain 3DGS beside every method, counts once. Raises `UserError` if only some items have
    the column of captures.
    """
    scores, timings, experiments = tuple(scores), tuple(timings), tuple(experiments)
    items = (*scores, *timings, *experiments)
    _check_captures(items, columns)
    iterations = min(_stated(items, "iterations"), default=None)
    usual = {**setup, **({"iterations": iterations} if iterations is not None else {})}

    def usual_of(item: Item) -> Mapping[str, float]:
        alike = [each for each in items if each.values.get(columns.capture) == item.values.get(columns.capture)]
        bounds = _stated(alike, "gaussians")
        own = {"decoder_width": width} if (width := _only_width(items, item, columns)) is not None else {}
        return {**usual, **own, **({"gaussians": max(bounds)} if bounds else {})}

    scored = _distinct(run for item in scores for run in _runs_of(item, columns, usual_of(item)))
    timed = _distinct(run for item in timings for run in _runs_of(item, columns, usual_of(item)))
    # timings name no message, so fewer values distinguish them
    names = _telling(timed, columns) | _telling(scored, columns)
    tried = [experiment for item in experiments for experiment in _experiments_of(item, columns, usual_of(item))]
    titles = shortest_titles({run.capture for run in (*scored, *timed)} | {each.capture for each in tried})
    return Study(
        tuple(replace(_with_settings(run, names[run.method]), capture=titles[run.capture]) for run in scored),
        tuple(replace(_with_settings(run, names[run.method]), capture=titles[run.capture]) for run in timed),
        tuple((item.label, item.cause or "not made") for item in items if item.artifact is None),
        iterations,
        tuple(replace(each, capture=titles[each.capture]) for each in _told_apart(tried, columns)),
        tuple(dict.fromkeys((item.stage, item.artifact.digest) for item in items if item.artifact is not None)),
    )


def _stated(items: Iterable[Item], name: str) -> list[float]:
    """All numbers that items state for a setting."""
    values = [number_or_text(item.values[name]) for item in items if item.values.get(name) is not None]
    return [value for value in values if isinstance(value, float)]


def _only_width(items: Iterable[Item], item: Item, columns: Columns) -> float | None:
    """The decoders' width that all items of this item's method state, if it is a method of one's own; else None."""
    method = item.values.get(columns.method)
    alike = [each for each in items if each.values.get(columns.method) == method]
    widths = set(_stated(alike, "decoder_width"))
    return widths.pop() if method not in (None, *METHOD_TITLES) and len(widths) == 1 else None


def by_kind(runs: Iterable[Run]) -> dict[tuple[object, ...], tuple[Run, ...]]:
    """Runs grouped by `Run.kind`: the paper's methods first, in its order, then others."""
    order = list(METHOD_TITLES)
    groups: dict[tuple[object, ...], list[Run]] = {}
    for run in sorted(runs, key=lambda run: order.index(run.method) if run.method in order else len(order)):
        groups.setdefault(run.kind, []).append(run)
    return {kind: tuple(group) for kind, group in groups.items()}


def by_method(experiments: Iterable[Experiment]) -> dict[str, tuple[Experiment, ...]]:
    """Experiments that differ only in capture and seed, grouped: the paper's methods first, in its order.

    The key is the method if its settings are the usual ones, or the only ones measured. Otherwise it is the title, so
    that a container with another λ is not taken for one more seed.
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


def shortest_titles(captures: Collection[str]) -> dict[str, str]:
    """For each capture, which may be a path, as many of its last components as no other one ends in.

    >>> shortest_titles(["photos/fox", "monday/garden", "tuesday/garden", ""])
    {'photos/fox': 'fox', 'monday/garden': 'monday/garden', 'tuesday/garden': 'tuesday/garden', '': ''}
    """
    paths = {capture: Path(capture).parts for capture in captures}
    titles = {}
    for capture, own in paths.items():
        others = [parts for other, parts in paths.items() if other != capture]
        lengths = range(1, len(own) + 1)
        length = next((size for size in lengths if all(each[-size:] != own[-size:] for each in others)), len(own))
        titles[capture] = Path(*own[-length:]).as_posix() if own else capture
    return titles


def capture_title(capture: str) -> str:
    """A capture's name in tables; "Capture" if it has none."""
    return capture or "Capture"


def _runs_of(item: Item, columns: Columns, usual: Mapping[str, float]) -> list[Run]:
    if item.artifact is None:
        return []
    rows = read_rows(item.artifact)
    stated = item.values.get(columns.method)
    first = str(stated) if stated is not None else next((row.method for row in rows if row.method), PLAIN)
    groups: dict[str, list[MetricRow]] = {}
    for row in rows:
        method = row.method or first
        if method != PLAIN or row.message is None:  # messages of plain 3DGS are only a control
            groups.setdefault(method, []).append(row)
    capture, seed, message = (_text(item, column) for column in (columns.capture, columns.seed, columns.message))
    other = tuple(f"{name}={value}" for name, value in sorted(others(item.values, _known(columns)).items()))
    return [
        Run(
            capture,
            method,
            stated_settings(item, method, usual_of_pictures(group, usual_settings(method, usual))),
            seed,
            tuple(group),
            other if method != PLAIN else (),
            item.stage,
            item.artifact.digest,
            message if method != PLAIN else "",
        )
        for method, group in groups.items()
    ]


def _text(item: Item, column: str) -> str:
    """An item's value as text; empty if it states none."""
    value = item.values.get(column)
    return "" if value is None else str(value)


def _experiments_of(item: Item, columns: Columns, usual: Mapping[str, float]) -> list[Experiment]:
    """One experiment for each method that the item's rows name."""
    if item.artifact is None:
        return []
    groups: dict[str, list[Measurement]] = {}
    for row in read_measurements(item.artifact):
        groups.setdefault(row.method or str(item.values.get(columns.method, "")), []).append(row)
    capture, seed = _text(item, columns.capture), _text(item, columns.seed)
    return [
        Experiment(
            capture,
            method,
            seed,
            tuple(rows),
            item.values,
            item.stage,
            stated_settings(item, method, usual_settings(method, usual)),
        )
        for method, rows in groups.items()
    ]


def _distinct(runs: Iterable[Run]) -> tuple[Run, ...]:
    """Each training once: a run is dropped if one of the same capture, method and settings has all of its rows."""
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


def _telling(runs: Sequence[Run], columns: Columns) -> dict[str, set[str]]:
    """By method, the names of the values in which runs differ that are alike in everything else."""
    return telling((run.method, (run.capture, run.kind, run.seed), _possible(_stated_by(run), columns)) for run in runs)


def _possible(stated: Mapping[str, object], columns: Columns) -> dict[str, float | str]:
    """`possible_settings` without the message: a folder may be called 20240502."""
    return possible_settings({name: value for name, value in stated.items() if name != columns.message})


def _stated_by(run: Run) -> dict[str, str]:
    return dict(text.split("=", 1) for text in run.other)


def _with_settings(run: Run, names: set[str]) -> Run:
    """The run, with its other values of these names moved to its settings."""
    other = tuple(text for text in run.other if text.split("=", 1)[0] not in names)
    return replace(run, settings=(*run.settings, *_among(possible_settings(_stated_by(run)), names)), other=other)


def _told_apart(experiments: Sequence[Experiment], columns: Columns) -> tuple[Experiment, ...]:
    """The experiments, with the values that distinguish them among their settings.

    Experiments of different stages are different measurements of one container.
    """
    stated = [_possible(others(each.values, _known(columns)), columns) for each in experiments]
    names = telling(
        (each.method, (each.stage, each.capture, each.settings, each.seed), own)
        for each, own in zip(experiments, stated, strict=True)
    )
    return tuple(
        replace(each, settings=(*each.settings, *_among(own, names[each.method])))
        for each, own in zip(experiments, stated, strict=True)
    )


def _among(stated: PossibleSettings, names: set[str]) -> Settings:
    return tuple((name, value) for name, value in stated.items() if name in names)


def _scored(run: Run) -> set[tuple[MetricRow, bool]]:
    """The run's rows, each with whether it was measured; for unmeasured ones, 0 replaces NaN, which equals nothing."""
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
