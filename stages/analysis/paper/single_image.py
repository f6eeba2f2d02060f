"""The table of a single image, which one view hides: what it costs the cover, there and elsewhere."""

from __future__ import annotations

from collections.abc import Sequence

from stages.analysis.page.material import DECODER, GS_HIDER, PLAIN
from stages.analysis.page.tables import Column, mean_of
from stages.analysis.paper.chapter import (
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
from stages.analysis.paper.measuring import Figure, Measured, cover, measure, noise
from stages.analysis.paper.published import Published, average
from stages.analysis.paper.relations import Relation
from stages.analysis.paper.runs import Run, Study
from stages.imaging.metric_table import MetricRow, mean_value

COVER, MESSAGE, THERE, ELSEWHERE = "Cover", "Image", "Cover, the view that hides it", "Cover, other training views"
LEAST_OF_THE_IMAGE = 40.0
MOST_LOST_ON_THE_COVER = 0.8
NOTE = "Cover: test views. The image: at the one view that hides it. The paper's image is Boat.png."


def single_image(study: Study, tables: Published) -> Chapter:
    """One image, or several of them one at a time, hidden at one view each."""
    runs = usual(study.select(lambda run: run.method == PLAIN or run.hides_image))
    figures: dict[str, Figure] = {
        COVER: cover("psnr"),
        THERE: cover_where_it_hides,
        ELSEWHERE: cover_elsewhere,
        MESSAGE: image_psnr,
    }
    plain = of_method(runs, PLAIN, cover("psnr"))
    captures, lines = study.captures, list[Line]()
    for method, title, group in blocks(runs, tables.single_image):
        for image in dict.fromkeys(name for run in group for name in run.messages or ("",)):
            own = [run for run in group if run.messages == (image,) or not image]
            for picture, figure in figures.items():
                reference = plain if picture == COVER and method != PLAIN else None
                cells = measured_cells("psnr", measure(own, figure), reference, captures)
                lines.append(Line((title, f"{picture} · {image}" if image else picture, HERE), tuple(cells)))
        if title == title_of(method):
            lines += _published_lines(method, captures, tables)
    grid = Grid(
        "One image at one view: PSNR (dB)",
        ("Method", "Picture", "Figures"),
        headings(captures),
        tuple(lines),
        (NOTE, noise_note({"cover": noises(runs, study)["cover"]})),
    )
    return Chapter("An image hidden at one view", (without_empty_columns(grid),), _relations(runs, study, tables), runs)


def cover_where_it_hides(run: Run) -> float:
    """The cover's PSNR at the very view that hides the image; NaN where none does."""
    return mean_value([row for row in _cover_rows(run) if row.view in run.hiding_views])


def cover_elsewhere(run: Run) -> float:
    """The cover's PSNR at the other training views; NaN where no view hides an image."""
    others = [row for row in _cover_rows(run) if row.view not in run.hiding_views]
    return mean_of(others if run.hides_image else [], Column("psnr", "train"))


def lost_where_it_hides(run: Run) -> float:
    """The cover's PSNR at the view that hides the image, to that at the other training views."""
    return cover_where_it_hides(run) - cover_elsewhere(run)


def image_psnr(run: Run) -> float:
    """The image's PSNR at the view that hides it."""
    hidden = [row for row in run.rows if row.quantity == "psnr" and row.message is not None]
    return mean_value([row for row in hidden if row.view in run.hiding_views])


def _cover_rows(run: Run) -> list[MetricRow]:
    return [row for row in run.rows if row.quantity == "psnr" and row.message is None]


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
    name, rival = title_of(GS_HIDER), title_of(DECODER)
    of_cover = noises(runs, study)["cover"].deviation
    of_image, of_the_loss = (noise(runs, figure).deviation for figure in (image_psnr, lost_where_it_hides))
    hider, decoder = tables.single_image[GS_HIDER], tables.single_image[DECODER]

    def of(method: str, figure: Figure) -> Measured:
        return of_method(runs, method, figure)

    images = of(GS_HIDER, image_psnr)
    return (
        Relation(
            f"{name}: the image", "figure", "at least", LEAST_OF_THE_IMAGE, images, average(hider.message), of_image
        ),
        Relation(
            f"{name} not far under 3DGS on the cover",
            "difference",
            "at least",
            -MOST_LOST_ON_THE_COVER,
            of(GS_HIDER, cover("psnr")).minus(of(PLAIN, cover("psnr"))),
            average(hider.cover) - average(tables.single_image[PLAIN].cover),
            of_cover,
        ),
        Relation(
            f"{name} above {rival} on the cover",
            "difference",
            "more than",
            0.0,
            of(GS_HIDER, cover("psnr")).minus(of(DECODER, cover("psnr"))),
            average(hider.cover) - average(decoder.cover),
            of_cover,
        ),
        Relation(
            f"{name} above {rival} on the image",
            "difference",
            "more than",
            0.0,
            images.minus(of(DECODER, image_psnr)),
            average(hider.message) - average(decoder.message),
            of_image,
        ),
        Relation(
            f"{rival} overfits: its cover at the view that hides the image, to its other training views",
            "difference",
            "less than",
            0.0,
            of(DECODER, lost_where_it_hides),
            noise=of_the_loss,
            source="shown",
        ),
        Relation(
            f"{name} is immune: the same, less than {rival} loses there",
            "difference",
            "more than",
            0.0,
            of(GS_HIDER, lost_where_it_hides).minus(of(DECODER, lost_where_it_hides)),
            noise=of_the_loss,
            source="shown",
        ),
    )
