"""The public part of a container's scores: what anyone can render from it, and only what is allowed of the photos."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

from stages.analysis.comparisons import Comparison
from stages.imaging.metric_table import MetricRow, mean_value


def rows_for_the_public(rows: Iterable[MetricRow], private_cover: bool) -> list[MetricRow]:
    """The cover's figures: one per test view, but only means over training views.

    A training view that hides an image could stand out by its own figure. If the cover is private, so are its photos'
    names, and test views are averaged too. `total_bytes` and rows of messages are left out: they would reveal that
    there is a secret, and its size.
    """
    public = [row for row in rows if row.message is None and row.quantity != "total_bytes"]
    kept, means = [], dict[MetricRow, list[MetricRow]]()
    for row in public:
        if row.view is not None and (private_cover or row.split == "train"):
            means.setdefault(replace(row, view=None, value=0.0), []).append(row)
        else:
            kept.append(row)
    return kept + [replace(of, value=mean_value(each)) for of, each in means.items()]


def comparisons_for_the_public(
    pictures: Iterable[Comparison], views: Collection[str], private_cover: bool
) -> list[Comparison]:
    """The cover's pictures in `views`; if the cover is private, numbered and without its photos.

    The feature map is left out: a sealed container's is rendered after the secret has opened it.
    """
    public = [picture.of_views(views) for picture in pictures if picture.role == "cover"]
    shown = [picture for picture in public if picture.names]
    return [_without_photos(picture) for picture in shown] if private_cover else shown


def _without_photos(picture: Comparison) -> Comparison:
    numbers = tuple(f"view {number}" for number in range(1, len(picture.names) + 1))
    return replace(picture, names=numbers, truth=picture.rendered, has_truth=False)
