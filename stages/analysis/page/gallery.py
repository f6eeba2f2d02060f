"""Pictures side by side with the truth, small enough to be embedded in the page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stages.analysis.comparisons import Comparison
from stages.analysis.page.figures import write_figure
from stages.analysis.stored_views import Views
from stages.imaging.pictures import Picture, encode_jpeg, encode_png, picture_to_tensor, resize_picture
from stages.imaging.psnr import psnr
from stages.scene.even_spread import evenly_spread

RESIDUAL_GAIN = 8
LOSSLESS_PIXELS = 2_500_000  # about 6 MB as PNG inside the page; JPEG beyond
JPEG_QUALITY = 92
LONGEST_SIDE = 800  # pixels; forty pictures of 1,600 would make a page of 60 MB
WIDEST_COMPARISON = 5
THUMBNAILS = 6


@dataclass(frozen=True)
class Shown:
    """A picture with its caption; ``note`` is a figure or remark under it."""

    caption: str
    picture: Picture
    note: str = ""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture on the page, where its long side is at most `LONGEST_SIDE`."""
        height, width = self.picture.shape[:2]
        factor = min(1.0, LONGEST_SIDE / max(height, width))
        return max(1, round(width * factor)), max(1, round(height * factor))

    def data_uri(self, lossless: bool) -> str:
        """The picture as a data URI, a PNG if `lossless` and otherwise a JPEG."""
        shrunk = resize_picture(self.picture, *self.size)
        kind, data = ("png", encode_png(shrunk)) if lossless else ("jpeg", encode_jpeg(shrunk, JPEG_QUALITY))
        return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


@dataclass(frozen=True)
class View:
    """Pictures of one camera."""

    name: str
    split: str
    pictures: tuple[Shown, ...]

    @property
    def columns(self) -> int:
        """How many pictures stand side by side if there is room."""
        return len(self.pictures) if len(self.pictures) <= WIDEST_COMPARISON else THUMBNAILS


@dataclass(frozen=True)
class Gallery:
    """A heading with the views under it."""

    title: str
    views: tuple[View, ...]

    @property
    def without_names(self) -> Gallery:
        """The gallery with numbers in place of the photos' names, which may name a person or a place."""
        numbered = (replace(view, name=view.name and f"View {n}") for n, view in enumerate(self.views, start=1))
        return replace(self, views=tuple(numbered))

    @property
    def narrow(self) -> bool:
        """Whether two views fit beside each other."""
        return all(len(view.pictures) <= 2 for view in self.views)

    @property
    def tall(self) -> bool:
        """Whether a picture is taller than wide, so that pictures must not fill the page's width."""
        return any(shown.picture.shape[0] > shown.picture.shape[1] for view in self.views for shown in view.pictures)


def is_lossless(galleries: Sequence[Gallery]) -> bool:
    """Whether all pictures together are few enough for PNG."""
    return sum(width * height for width, height in (shown.size for shown in all_shown(galleries))) <= LOSSLESS_PIXELS


def are_shrunk(galleries: Sequence[Gallery]) -> bool:
    """Whether some picture is larger than it is shown on the page."""
    return any(max(shown.picture.shape) > LONGEST_SIDE for shown in all_shown(galleries))


def all_shown(galleries: Sequence[Gallery]) -> list[Shown]:
    """Every picture, in order."""
    return [shown for gallery in galleries for view in gallery.views for shown in view.pictures]


def cover_gallery(covers: Sequence[Comparison], count: int, title: str, residual: bool) -> Gallery | None:
    """For each view the truth, each method's render and, if `residual`, the first method's residual.

    None without covers. If none of them has a truth, the gallery shows only the first method's renders.
    """
    if not covers:
        return None
    if not any(each.has_truth for each in covers):
        return picture_gallery(covers[0], count, title)
    covers = [each for each in covers if each.has_truth]
    views = []
    for name, split in chosen_views(covers[0], count):
        truth = _picture(covers[0].truth, covers[0], name)
        rendered = [_rendered(each.method, each, name) for each in covers if name in each.names]
        shown = [Shown("Truth", truth), *rendered]
        if residual:
            shown.append(Shown(f"Residual ×{RESIDUAL_GAIN}", _residual(rendered[0].picture, truth)))
        views.append(View(name, split, tuple(shown)))
    return Gallery(title, tuple(views))


def message_gallery(message: Comparison, count: int, title: str) -> Gallery:
    """For each view the truth and the recovered message; only the latter if there is no truth."""
    if not message.has_truth:
        return picture_gallery(message, count, title)
    return Gallery(
        title,
        tuple(
            View(
                name,
                split,
                (Shown("Truth", _picture(message.truth, message, name)), _rendered("Recovered", message, name)),
            )
            for name, split in chosen_views(message, count)
        ),
    )


def picture_gallery(pictures: Comparison, count: int, title: str) -> Gallery:
    """Pictures without a truth, such as feature maps and what a stranger's container shows."""
    shown = (Shown(name, _picture(pictures.rendered, pictures, name)) for name, _ in chosen_views(pictures, count))
    return Gallery(title, (View("", "", tuple(shown)),))


def chosen_views(comparison: Comparison, count: int) -> list[tuple[str, str]]:
    """At most ``count`` evenly spread views with their splits: test views first, then training views for the rest."""
    pairs = list(zip(comparison.names, comparison.splits, strict=True))
    test = [pair for pair in pairs if pair[1] == "test"]
    others = [pair for pair in pairs if pair[1] != "test"]
    return _spread(test, count) + _spread(others, count - len(test))


def _spread(pairs: list[tuple[str, str]], count: int) -> list[tuple[str, str]]:
    return [pairs[position] for position in evenly_spread(len(pairs), count)]


def _rendered(caption: str, comparison: Comparison, name: str) -> Shown:
    rendered, truth = (_picture(each, comparison, name) for each in (comparison.rendered, comparison.truth))
    decibels = psnr(picture_to_tensor(rendered), picture_to_tensor(truth))
    return Shown(caption, rendered, f"{write_figure('psnr', decibels)} dB")


def _residual(rendered: Picture, truth: Picture) -> Picture:
    difference = np.abs(rendered.astype(np.int16) - truth.astype(np.int16))
    return (difference * RESIDUAL_GAIN).clip(0, 255).astype(np.uint8)


def _picture(pictures: Views, comparison: Comparison, name: str) -> Picture:
    return pictures[comparison.names.index(name)]
