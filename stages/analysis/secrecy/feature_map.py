"""What the feature map shows as it is: its channels and principal components beside the cover and the message.

The paper shows three channels, and finds that they look like the cover and show "no traces" of the message. Eyes are a
poor judge of that: here every channel has a correlation with both, beside two controls: the message of other views,
and the channels of a container that hides nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from stages.analysis.secrecy.blind import principal_directions
from stages.analysis.secrecy.conditions import ALL, CHANNEL, CHANNELS, COMPONENT, COMPONENTS, SHOWN
from stages.analysis.secrecy.linear import multiple_correlations, neighbourhoods
from stages.analysis.secrecy.measuring import edges, luma, matched
from stages.analysis.secrecy.observing import Observed
from stages.imaging.metric_table import mean_of_known


@dataclass(frozen=True)
class Correlated:
    """Figures of one view: with the cover, with the message, and with the message of other views; without sign.

    `edges_…` are the same of the lengths of gradients; NaN for several channels together. `message` is a number.
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
    """Every line for every view and message, of luminances. Empty without views."""
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
    found = []
    for message in range(len(views[0].truths)):
        for line, channels in singles.items():
            found += _of_single(line, channels, views, message)
        for line, together in several.items():
            found += _of_several(line, together, views, message)
    return found


def _shown(feature_map: Float[Tensor, "H W M"]) -> range:
    return range(min(SHOWN, feature_map.shape[-1]))


def _of_single(
    line: str, channels: Sequence[Float[Tensor, "H W"]], views: Sequence[Observed], message: int
) -> list[Correlated]:
    covers = [luma(seen.cover) for seen in views]
    truths = [luma(seen.truths[message]) for seen in views]
    outlines = [edges(channel) for channel in channels]
    with_cover = matched(channels, covers)
    with_message = matched(channels, truths)
    edges_cover = matched(outlines, [edges(grey) for grey in covers])
    edges_message = matched(outlines, [edges(grey) for grey in truths])
    return [
        Correlated(
            line, view, message, with_cover[view][0], *with_message[view], edges_cover[view][0], *edges_message[view]
        )
        for view in range(len(views))
    ]


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
