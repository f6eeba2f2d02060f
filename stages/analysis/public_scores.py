"""What the public learns of a container's scores: what any holder of the container can render, and of the photos no
more than the workflow lets it see."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

from stages.analysis.comparisons import Comparison
from stages.imaging.metric_table import MetricRow, mean_value


def rows_for_the_public(rows: Iterable[MetricRow], private_cover: bool) -> list[MetricRow]:
    """Figures of the cover: of training views means alone, since the view that hides an image may stand out by its own.

    Where the cover is private, so are its photos' names: means alone of test views, too. The size in all would tell
    that there is a secret, and how large it is; rows of a message, that there is one.
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
    """The cover of `views`; where it is private, without its photos and under numbers.

    Not the feature map: of a sealed container it was rendered after the secret had opened it.
    """
    public = [picture.of_views(views) for picture in pictures if picture.role == "cover"]
    shown = [picture for picture in public if picture.names]
    return [_without_photos(picture) for picture in shown] if private_cover else shown


def _without_photos(picture: Comparison) -> Comparison:
    numbers = tuple(f"view {number}" for number in range(1, len(picture.names) + 1))
    return replace(picture, names=numbers, truth=picture.rendered, has_truth=False)
