"""The table of a single image, hidden in one view: what it costs the cover there and in other views."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from stages.analysis.method_titles import DECODER, GS_HIDER
from stages.analysis.page.figures import label
from stages.analysis.page.tables import PICTURE_QUANTITIES, Column, mean_of
from stages.analysis.paper.chapter import (
    LPIPS,
    Chapter,
    blocks,
    noise_note,
    noises,
    of_method,
    title_of,
    usual,
)
from stages.analysis.paper.grid import (
    HERE,
    PAPER,
    Grid,
    Line,
    headings,
    measured_cells,
    published_cells,
    without_empty_columns,
)
from stages.analysis.paper.measuring import Figure, cover, measure, noise
from stages.analysis.paper.published import Published, average
from stages.analysis.paper.relations import Relation
from stages.analysis.paper.runs import Run, Study
from stages.hiding.method_names import PLAIN
from stages.imaging.metric_table import MetricRow, mean_value

COVER, TRAINING, MESSAGE = "Cover", "Cover, training views", "Image"
THERE, ELSEWHERE = "Cover, the view that hides it", "Cover, other training views"
LEAST_OF_THE_IMAGE = 40.0
MOST_LOST_ON_THE_COVER = 0.8
NOTE = (
    "Cover: test views unless stated otherwise; training views include the one that hides the image. Image: in that "
    "view only. The paper's image is Boat.png."
)


def single_image(study: Study, tables: Published) -> Chapter:
    """The chapter on one image, or several images one at a time, each hidden in one view."""
    runs = usual(study.select(lambda run: run.method == PLAIN or run.hides_image))
    grids = [_grid(quantity, runs, study, tables) for quantity in PICTURE_QUANTITIES]
    return Chapter(
        "An image hidden in one view",
        tuple(grid for grid in grids if grid.lines),
        _relations(runs, study, tables),
        runs,
    )


def _grid(quantity: str, runs: Sequence[Run], study: Study, tables: Published) -> Grid:
    """The image, and the cover on test and training views, in the hiding view and elsewhere.

    Below the PSNR are the paper's rows.
    """
    figures: dict[str, Figure] = {
        COVER: cover(quantity),
        TRAINING: cover(quantity, "train"),
        THERE: cover_where_it_hides(quantity),
        ELSEWHERE: cover_elsewhere(quantity),
        MESSAGE: image_figure(quantity),
    }
    plain = {picture: of_method(runs, PLAIN, figures[picture]) for picture in (COVER, TRAINING)}
    captures, lines = study.captures, list[Line]()
    for method, title, group in blocks(runs, tables.single_image):
        for image in dict.fromkeys(name for run in group for name in run.messages or ("",)):
            own = [run for run in group if run.messages == (image,) or not image]
            for picture, figure in figures.items():
                reference = plain.get(picture) if method != PLAIN else None
                by_networks = picture == COVER or (bool(image) and picture == MESSAGE)
                expected = quantity in LPIPS and by_networks and bool(own)
                cells = measured_cells(quantity, measure(own, figure), reference, captures, expected)
                lines.append(Line((title, f"{picture} · {image}" if image else picture, HERE), tuple(cells)))
        if title == title_of(method) and quantity == "psnr":
            lines += _published_lines(method, captures, tables)
    spreads = {"cover": noises(runs, study, quantity)["cover"]}
    return without_empty_columns(
        Grid(
            f"One image in one view: {label(quantity)}",
            ("Method", "Picture", "Figures"),
            headings(captures),
            tuple(lines),
            (NOTE, noise_note(spreads, quantity, " dB" if quantity == "psnr" else "")),
        )
    )


def cover_where_it_hides(quantity: str) -> Figure:
    """The cover's figure in the view that hides the image; NaN if none does."""
    return lambda run: mean_value([row for row in _cover_rows(run, quantity) if row.view in run.hiding_views])


def cover_elsewhere(quantity: str) -> Figure:
    """The cover's mean figure in the other training views; NaN if no view hides an image."""

    def elsewhere(run: Run) -> float:
        others = [row for row in _cover_rows(run, quantity) if row.view not in run.hiding_views]
        return mean_of(others if run.hides_image else [], Column(quantity, "train"))

    return elsewhere


def image_figure(quantity: str) -> Figure:
    """The image's figure in the view that hides it; NaN if none does."""

    def figure(run: Run) -> float:
        hidden = [row for row in run.rows if row.quantity == quantity and row.message is not None]
        return mean_value([row for row in hidden if row.view in run.hiding_views])

    return figure


image_psnr = image_figure("psnr")


def lost_where_it_hides(run: Run) -> float:
    """The cover's PSNR in the view that hides the image minus that in the other training views, in dB."""
    return cover_where_it_hides("psnr")(run) - cover_elsewhere("psnr")(run)


def _cover_rows(run: Run, quantity: str) -> list[MetricRow]:
    return [row for row in run.rows if row.quantity == quantity and row.message is None]


def _published_lines(method: str, captures: Sequence[str], tables: Published) -> list[Line]:
    if method not in tables.single_image:
        return []
    entry, plain = tables.single_image[method], tables.single_image[PLAIN].cover
    rows = ((COVER, entry.cover, None if method == PLAIN else plain), (MESSAGE, entry.message, None))
    return [
        Line(
            (title_of(method), picture, PAPER),
            tuple(published_cells("psnr", row, reference, captures, tables)),
            published=True,
        )
        for picture, row, reference in rows
    ]


def _relations(runs: Sequence[Run], study: Study, tables: Published) -> tuple[Relation, ...]:
    return (*_against_the_paper(runs, study, tables), *_overfitting(runs))


def _against_the_paper(runs: Sequence[Run], study: Study, tables: Published) -> Iterator[Relation]:
    """What the paper's table says of GS-Hider, beside 3DGS and 3DGS+Decoder."""
    name, rival = title_of(GS_HIDER), title_of(DECODER)
    of_cover, of_image = noises(runs, study)["cover"], noise(runs, image_psnr)
    covers = {method: of_method(runs, method, cover("psnr")) for method in (PLAIN, DECODER, GS_HIDER)}
    images = {method: of_method(runs, method, image_psnr) for method in (DECODER, GS_HIDER)}
    paper = tables.single_image
    hider, decoder = paper[GS_HIDER], paper[DECODER]
    image = average(hider.message)
    yield Relation(f"{name}: the image", "figure", "at least", LEAST_OF_THE_IMAGE, images[GS_HIDER], image, of_image)
    yield Relation(
        f"{name} not far below 3DGS on the cover",
        "difference",
        "at least",
        -MOST_LOST_ON_THE_COVER,
        covers[GS_HIDER].minus(covers[PLAIN]),
        average(hider.cover) - average(paper[PLAIN].cover),
        of_cover,
    )
    yield Relation(
        f"{name} above {rival} on the cover",
        "difference",
        "more than",
        0.0,
        covers[GS_HIDER].minus(covers[DECODER]),
        average(hider.cover) - average(decoder.cover),
        of_cover,
    )
    yield Relation(
        f"{name} above {rival} on the image",
        "difference",
        "more than",
        0.0,
        images[GS_HIDER].minus(images[DECODER]),
        image - average(decoder.message),
        of_image,
    )


def _overfitting(runs: Sequence[Run]) -> Iterator[Relation]:
    """What the paper shows of the view that hides the image, without figures."""
    name, rival = title_of(GS_HIDER), title_of(DECODER)
    lost = {method: of_method(runs, method, lost_where_it_hides) for method in (DECODER, GS_HIDER)}
    of_the_loss = noise(runs, lost_where_it_hides)
    yield Relation(
        f"{rival} overfits: its cover in the view that hides the image, vs. its other training views",
        "difference",
        "less than",
        0.0,
        lost[DECODER],
        noise=of_the_loss,
        source="shown",
    )
    yield Relation(
        f"{name} is immune: its cover loses less in that view than that of {rival}",
        "difference",
        "more than",
        0.0,
        lost[GS_HIDER].minus(lost[DECODER]),
        noise=of_the_loss,
        source="shown",
    )
