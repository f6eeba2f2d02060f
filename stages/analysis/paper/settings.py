"""The settings that distinguish runs of one method: which of them an item states, and how titles show them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pipeline.stage import Item
from stages.analysis.method_titles import DECODER, GS_HIDER, METHOD_TITLES, OURS, SECOND_HARMONICS
from stages.analysis.probes import probed
from stages.hiding.method_names import PLAIN
from stages.hiding.methods import decoder, gs_hider, homogeneous, sh
from stages.hiding.methods.homogeneous import PRESETS, SCENE_PRESETS
from stages.imaging.metric_table import MetricRow

SETTINGS = {
    "lambda_message": "λ = {}",
    "feature_dim": "M = {}",
    "layers": "{} layers",
    "decoder_width": "decoders {} wide",
    "iterations": "{} iterations",
    "gaussians": "at most {} Gaussians",
    "sealed": "sealed",
}
"""Columns of items that distinguish runs of one method, and how the titles of lines show their values."""

SETTINGS_OF_PLAIN = ("iterations", "gaussians")
"""The settings of plain 3DGS, none of which concerns hiding."""

BUILT_FROM = {
    SECOND_HARMONICS: sh.SETTINGS,
    DECODER: decoder.SETTINGS,
    GS_HIDER: gs_hider.SETTINGS,
    OURS: homogeneous.SETTINGS,
}
"""What each method here is built from: rows of a table state the same columns for all methods, also those without."""

BUILDING = ("feature_dim", "layers", "decoder_width")
"""Those of `SETTINGS` that only some methods are built from."""

DECODER_WIDTH = 64.0
"""The usual width of decoders, in channels; the paper does not state it."""

Settings = tuple[tuple[str, float | str], ...]
"""Settings and their values, in the order of `SETTINGS`."""


def usual_settings(method: str, setup: Mapping[str, float]) -> Mapping[str, float]:
    """The usual settings of a method, or of a probe of it: the paper's, or for our method its own presets."""
    own = {**PRESETS, **SCENE_PRESETS} if _without_probe(method) == OURS else {}
    return {"decoder_width": DECODER_WIDTH, **setup, **{name: own[name] for name in SETTINGS if name in own}}


def _without_probe(method: str) -> str:
    """The method that a run is of, if it is named after a probe, too."""
    probe = probed(method)
    return probe[0] if probe else method


def usual_of_pictures(rows: Sequence[MetricRow], usual: Mapping[str, float]) -> Mapping[str, float]:
    """The usual settings for these rows: a hidden image has its own λ."""
    hides_image = any(row.quantity == "hides_image" for row in rows)
    return {**usual, "lambda_message": usual["lambda_image"]} if hides_image else usual


def stated_settings(item: Item, method: str, usual: Mapping[str, float]) -> Settings:
    """The method's settings that the item states and that are not the usual ones, or have no usual value."""
    built_from = BUILT_FROM.get(_without_probe(method), BUILDING)
    own = [name for name in SETTINGS if name not in BUILDING or name in built_from]
    names = own if method != PLAIN else SETTINGS_OF_PLAIN
    given = {name: item.values.get(name) for name in names}
    stated = {name: number_or_text(value) for name, value in given.items() if value is not None and value is not False}
    return tuple((name, value) for name, value in stated.items() if value != usual.get(name))


def number_or_text(value: object) -> float | str:
    """A setting's value as runs are compared by it: any number as a float, anything else as text."""
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def settings_title(method: str, settings: Settings) -> str:
    """The method's title, followed by the settings."""
    title = METHOD_TITLES.get(method, method)
    return ", ".join([title, *(_title_of_setting(name).format(_written(value)) for name, value in settings)])


def _title_of_setting(name: str) -> str:
    return SETTINGS.get(name, f"{name.split('.')[-1].replace('_', ' ')} {{}}")


def _written(value: float | str) -> str:
    """A value as titles show it.

    >>> _written(0.1), _written(10_000_000.0), _written("fast")
    ('0.1', '10,000,000', 'fast')
    """
    if not isinstance(value, float):
        return value
    return f"{value:,.0f}" if value.is_integer() else f"{value:,g}"
