"""Correlations of the feature map's channels and principal components with the cover and the message.

The paper shows three channels, and finds that they look like the cover and show "no traces" of the message. The eye is
a poor judge of that, so correlations with both are measured, beside two controls: the message of other views, and the
channels of a container that hides nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from stages.analysis.leakage import correlation, matched_correlations
from stages.analysis.secrecy.blind import principal_directions
from stages.analysis.secrecy.conditions import ALL, CHANNEL, CHANNELS, COMPONENT, COMPONENTS, SHOWN
from stages.analysis.secrecy.linear import multiple_correlations, neighbourhoods
from stages.analysis.secrecy.measuring import edges, luma
from stages.analysis.secrecy.observing import Observed
from stages.imaging.metric_table import mean_of_known


@dataclass(frozen=True)
class Correlated:
    """Absolute correlations in one view: with the cover, with the message (`own`), and with that of other views.

    `edges_…` are those of gradient lengths; NaN for several channels together. `message` is the message's position,
    `line` one of `LINES`.
    """

    line: str
    view: int
    message: int
    cover: float
    own: float
    others: float
    edges_cover: float = math.nan
    edges_own: float = math.nan
    edges_others: float = math.nan


def feature_map_correlations(views: Sequence[Observed]) -> list[Correlated]:
    """Correlations of luminances for every view, message and line that the feature map has; empty without views."""
    maps = [seen.rendering.feature_map for seen in views]
    if not maps:
        return []
    directions = principal_directions(maps)
    components = [each @ directions for each in maps]
    singles = {
        **{CHANNEL.format(number + 1): [each[..., number] for each in maps] for number in _shown(maps[0])},
        **{COMPONENT.format(number + 1): [each[..., number] for each in components] for number in _shown(maps[0])},
    }
    several = {CHANNELS: [each[..., :SHOWN] for each in maps], COMPONENTS: components, ALL: maps}
    with_covers = {line: _with_covers(channels, views) for line, channels in singles.items()}
    found = []
    for message in range(len(views[0].truths)):
        for line, channels in singles.items():
            found += _of_single(line, channels, with_covers[line], views, message)
        for line, together in several.items():
            found += _of_several(line, together, views, message)
    return found


def _shown(feature_map: Float[Tensor, "H W M"]) -> range:
    return range(min(SHOWN, feature_map.shape[-1]))


def _with_covers(channels: Sequence[Float[Tensor, "H W"]], views: Sequence[Observed]) -> list[tuple[float, float]]:
    """For each view, |correlation| of a channel with the cover, and of its edges with the cover's edges."""
    found = []
    for channel, seen in zip(channels, views, strict=True):
        pair = channel, luma(seen.cover)
        found.append((abs(correlation(*_arrays(pair))), abs(correlation(*_arrays(map(edges, pair))))))
    return found


def _of_single(
    line: str,
    channels: Sequence[Float[Tensor, "H W"]],
    with_covers: Sequence[tuple[float, float]],
    views: Sequence[Observed],
    message: int,
) -> list[Correlated]:
    truths = [luma(seen.truths[message]) for seen in views]
    with_message = matched_correlations(_arrays(channels), _arrays(truths))
    with_edges = matched_correlations(_arrays(map(edges, channels)), _arrays(map(edges, truths)))
    figures = zip(with_covers, *with_message, *with_edges, strict=True)
    return [
        Correlated(line, view, message, cover, own, others, edges_cover, edges_own, edges_others)
        for view, ((cover, edges_cover), own, others, edges_own, edges_others) in enumerate(figures)
    ]


def _arrays(pictures: Iterable[Float[Tensor, "H W"]]) -> list[Float[np.ndarray, "H W"]]:
    return [picture.numpy() for picture in pictures]


def _of_several(
    line: str, maps: Sequence[Float[Tensor, "H W C"]], views: Sequence[Observed], message: int
) -> list[Correlated]:
    truths = [luma(seen.truths[message]) for seen in views]
    found = []
    for view, (channels, seen) in enumerate(zip(maps, views, strict=True)):
        regressors = neighbourhoods(channels, 1)
        with_cover, *values = multiple_correlations(regressors, torch.stack([luma(seen.cover), *truths], dim=-1))
        own = values.pop(view)
        found.append(Correlated(line, view, message, with_cover, own, mean_of_known(values)))
    return found
