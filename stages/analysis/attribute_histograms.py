"""Histograms of the attributes of a container's Gaussians, and divergences between those of two containers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Float, Float64, Int
from scipy.special import rel_entr

from stages.analysis.measurements import Measurement

BINS = 64
TAIL = 1e-3
"""Share of the values at either end that lie outside the equally wide bins and fall into the outermost ones."""
MOST_AT_ONCE = 10**6
"""Values of a container from which bins are chosen, and values that are counted at once: containers may have hundreds
of millions, of which copies in float64 would fill the memory."""
NOT_COMPARED = ("means", "quats")
"""Parameters that depend on the scene's axes and are therefore not compared."""

DIVERGENCE, CHANNELS, HISTOGRAM = "divergence", "divergence_of_channels", "histogram"
"""Quantities of one attribute, named by `of_attribute`. Divergences are in bits, from 0 to 1."""
GAUSSIANS, ONLY_THERE = "gaussians", "attributes_only_in_it"


def of_attribute(quantity: str, attribute: str) -> str:
    """The name of a quantity of one attribute."""
    return f"{quantity}: {attribute}"


def jensen_shannon(first: Float[np.ndarray, " B"], second: Float[np.ndarray, " B"]) -> float:
    """The Jensen-Shannon divergence of two non-empty histograms in bits: 0 if proportional, 1 if they share no bin.

    >>> jensen_shannon(np.array([1.0, 0]), np.array([0.0, 2])), jensen_shannon(np.array([1.0, 3]), np.array([2.0, 6]))
    (1.0, 0.0)
    """
    shares = [counts / counts.sum() for counts in (first, second)]
    middle = (shares[0] + shares[1]) / 2
    return float(sum(rel_entr(share, middle).sum() for share in shares)) / (2 * math.log(2))


def edges_of(*samples: Float[np.ndarray, "_ ..."]) -> Float64[np.ndarray, " edges"]:
    """Edges of `BINS` equally wide bins for the values of all samples; the two outermost are open-ended.

    If a sample has more than `MOST_AT_ONCE` values, only rows at even steps are looked at, the same steps in each, so
    that samples and channels count as they would otherwise. There must be a value.
    """
    step = math.ceil(max(values.size for values in samples) / MOST_AT_ONCE)
    pooled = np.concatenate([values[::step].ravel() for values in samples]).astype(float)
    low, high = np.quantile(pooled, [TAIL, 1 - TAIL])
    edges = np.linspace(low, max(high, low + 1e-9), BINS + 1)
    edges[0], edges[-1] = -np.inf, np.inf
    return edges


def counted(
    values: Float[np.ndarray, "_ ..."], edges: Float64[np.ndarray, " edges"]
) -> Float64[np.ndarray, " edges-1"]:
    """The number of values in each bin; a value on an edge counts in the bin above it."""
    bins = len(edges) - 1
    rows = max(1, MOST_AT_ONCE * len(values) // max(1, values.size))
    counts = np.zeros(bins, int)
    for start in range(0, len(values), rows):
        found = np.searchsorted(edges[1:-1], values[start : start + rows].ravel(), side="right")
        counts += np.bincount(found, minlength=bins)
    return counts.astype(float)


def divergence(values: Float[np.ndarray, "_ ..."], other: Float[np.ndarray, "_ ..."]) -> float:
    """The Jensen-Shannon divergence of two samples' histograms, in bits."""
    edges = edges_of(values, other)
    return jensen_shannon(counted(values, edges), counted(other, edges))


def compare_attributes(
    own: Mapping[str, Float[np.ndarray, "N ..."]],
    other: Mapping[str, Float[np.ndarray, "K ..."]],
    condition: str,
    method: str,
) -> Iterator[Measurement]:
    """How far the attributes of one set of Gaussians, `own`, differ from those of an `other`.

    Channels of different containers do not correspond. So `DIVERGENCE` pools all channels, and `CHANNELS` (if their
    numbers are equal and above 1) is the mean over pairs of equal rank by variance. Also gives the ratio of the numbers
    of Gaussians, and the number of attributes that only `own` has, since their names are published.
    """
    only = [name for name in own if name not in other]
    yield Measurement(ONLY_THERE, len(only), condition, method=method)
    yield Measurement(GAUSSIANS, len(own["means"]) / len(other["means"]), condition, method=method)
    for name in own:
        if _comparable(name, own, other):
            mine, theirs = _channels(own[name]), _channels(other[name])
            pooled = divergence(mine, theirs)
            yield Measurement(of_attribute(DIVERGENCE, name), pooled, condition, method=method)
            if mine.shape[1] == theirs.shape[1] > 1:
                pairs = zip(_by_variance(mine), _by_variance(theirs), strict=True)
                mean = float(np.mean([divergence(mine[:, first], theirs[:, second]) for first, second in pairs]))
                yield Measurement(of_attribute(CHANNELS, name), mean, condition, method=method)


def histogram_rows(
    containers: Mapping[str, Mapping[str, Float[np.ndarray, "_ ..."]]], method: str
) -> Iterator[Measurement]:
    """The share of values in every bin, for every attribute that all `containers` have.

    `containers` are at least two, keyed by the condition they stand for. The rows' severity is the middle of the bin,
    in the unit in which the attribute is stored.
    """
    first, *others = containers.values()
    for name in first:
        if not _comparable(name, first, *others):
            continue
        values = {condition: attributes[name] for condition, attributes in containers.items()}
        edges = edges_of(*values.values())
        width = edges[2] - edges[1]
        middles = edges[1] + width * (np.arange(BINS) - 0.5)
        for condition, own in values.items():
            shares = counted(own, edges) / own.size
            for middle, share in zip(middles.tolist(), shares.tolist(), strict=True):
                yield Measurement(of_attribute(HISTOGRAM, name), share, condition, middle, method=method)


def _comparable(name: str, *containers: Mapping[str, Float[np.ndarray, "_ ..."]]) -> bool:
    """Whether all have values of an attribute to compare; `sh_rest` is empty for harmonics of degree 0."""
    return name not in NOT_COMPARED and all(name in each and each[name].size for each in containers)


def _channels(values: Float[np.ndarray, "N ..."]) -> Float[np.ndarray, "N C"]:
    return values.reshape(len(values), -1)


def _by_variance(values: Float[np.ndarray, "N C"]) -> Int[np.ndarray, " C"]:
    """The numbers of the channels, that with the largest variance first."""
    return np.argsort(-values.var(axis=0), kind="stable")
