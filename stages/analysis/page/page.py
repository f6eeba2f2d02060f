"""The report's page as data for the template, and as HTML."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from pipeline.stage import LineageRecord
from stages.analysis.comparisons import Comparison, Role
from stages.analysis.page.chart import Chart, Series, line_chart
from stages.analysis.page.figures import write_seconds
from stages.analysis.page.films import Film, owner_films, public_films
from stages.analysis.page.gallery import (
    LONGEST_SIDE,
    Gallery,
    are_shrunk,
    cover_gallery,
    is_lossless,
    message_gallery,
    picture_gallery,
)
from stages.analysis.page.graph import Graph, draw_graph
from stages.analysis.page.html import fill
from stages.analysis.page.material import Material
from stages.analysis.page.summary import (
    Tile,
    message_tiles,
    owner_notices,
    owner_placed_tiles,
    owner_summary,
    owner_verdict,
    public_placed_tiles,
    scene_tiles,
)
from stages.analysis.page.tables import Table, tables_of
from stages.imaging.lpips_weights import HOW_TO_INSTALL
from stages.imaging.metric_table import MetricRow


@dataclass(frozen=True)
class StageFacts:
    """The details of a stage under the graph, as texts ready to show."""

    name: str
    uses: str
    time: str
    facts: tuple[tuple[str, str], ...]
    parameters: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Page:
    """Everything on the page; the template omits what is empty or None."""

    title: str
    summary: str
    notices: tuple[str, ...]
    tiles: tuple[Tile, ...]
    films: tuple[Film, ...]
    galleries: tuple[Gallery, ...]
    tables: tuple[Table, ...]
    remark: str
    charts: tuple[Chart, ...]
    graph: Graph | None
    stages: tuple[StageFacts, ...]
    versions: tuple[tuple[str, str], ...]
    devices: tuple[str, ...]
    command: str
    for_owner: bool

    @property
    def definitions(self) -> tuple[tuple[str, str], ...]:
        """The name and definition of each quantity in the tables."""
        return tuple(dict.fromkeys(each for table in self.tables for each in table.definitions))

    @property
    def compares(self) -> bool:
        """Whether a table marks the best of several methods."""
        return any(cell.best for table in self.tables for _, cells in table.lines for cell in cells)

    @property
    def lossless(self) -> bool:
        """Whether pictures are embedded as PNG."""
        return is_lossless(self.galleries)

    @property
    def about_pictures(self) -> str:
        """A note on the pictures if some are shown at a reduced size; otherwise empty."""
        if not are_shrunk(self.galleries):
            return ""
        how = "; `show --pictures` writes them" if self.for_owner else ""
        return f"Shown at most {LONGEST_SIDE} pixels long. Figures are for full-size pictures{how}."


def owner_page(material: Material, workflow: str, command: str, views: int) -> Page:
    """The page with all material, and the ``command`` that made it; it shows at most ``views`` views of each set."""

    def playing(role: Role) -> list[Comparison]:
        return [each for each in material.pictures if each.role == role]

    galleries = [
        cover_gallery(playing("cover"), views, "Cover", residual=True),
        *(
            message_gallery(each, views, _title(material, f"Message: {each.title}", each))
            for each in playing("message")
        ),
        *(picture_gallery(each, views, _title(material, "Feature map", each)) for each in playing("feature_map")),
    ]
    return _page(
        material,
        galleries,
        owner_films(material.videos),
        title=workflow,
        summary=" ".join((*map(owner_verdict, material.found), owner_summary(material))),
        notices=owner_notices(material),
        tiles=(*scene_tiles(material, "Cover"), *message_tiles(material), *owner_placed_tiles(material)),
        command=command,
        for_owner=True,
    )


def _title(material: Material, title: str, comparison: Comparison) -> str:
    """The title, with the method if several methods have pictures of this role."""
    sharing = {each.method for each in material.pictures if each.role == comparison.role}
    return title if len(sharing) == 1 else f"{title} · {comparison.method}"


def public_page(material: Material, views: int) -> Page:
    """The page about the scene alone, in words that fit any splatted scene, and without names of photos.

    If there is no public material, the summary says so.
    """
    pictures, films = cover_gallery(material.pictures, views, "Pictures", residual=False), public_films(material.videos)
    gallery = None if pictures is None else pictures.without_names
    tiles = (*scene_tiles(material, "Scene"), *public_placed_tiles(material))
    held = bool(material.scores) or any(each.has_truth for each in material.pictures)
    compared = f"A scene of 3D Gaussians{', compared with held-out photos' if held else ''}."
    return _page(
        material,
        [gallery],
        films,
        title="A Gaussian splatting scene",
        summary=compared if gallery or films or tiles else "None of it is public.",
        notices=(),
        tiles=tiles,
        command="",
        for_owner=False,
    )


def write_page(page: Page) -> str:
    """The page as self-contained HTML: it has no script and fetches nothing."""
    return fill("report.html", page)


def _page(
    material: Material,
    galleries: Iterable[Gallery | None],
    films: tuple[Film, ...],
    title: str,
    summary: str,
    notices: tuple[str, ...],
    tiles: tuple[Tile, ...],
    command: str,
    for_owner: bool,
) -> Page:
    charts = (
        _chart("PSNR of the training views (dB)", material.curves, "psnr"),
        _chart("Loss", material.curves, "loss", logarithmic=True),
        _chart("Gaussians", material.curves, "gaussians"),
    )
    return Page(
        title=title,
        summary=summary,
        notices=notices,
        tiles=tiles,
        films=films,
        galleries=tuple(gallery for gallery in galleries if gallery is not None),
        tables=tables_of(material),
        remark=_remark(material.scores) if for_owner else "",
        charts=tuple(chart for chart in charts if chart is not None),
        graph=draw_graph(material.lineage),
        stages=tuple(_stage_facts(record) for record in material.lineage),
        versions=tuple(sorted({item for record in material.lineage for item in record.versions.items()})),
        devices=tuple(dict.fromkeys(str(each.facts["device"]) for each in material.lineage if "device" in each.facts)),
        command=command,
        for_owner=for_owner,
    )


def _remark(rows: Sequence[MetricRow]) -> str:
    if not rows or any(row.quantity.startswith("lpips") and not math.isnan(row.value) for row in rows):
        return ""
    return f"LPIPS was not measured. If its weights are missing: {HOW_TO_INSTALL}"


def _chart(title: str, curves: Sequence[MetricRow], quantity: str, logarithmic: bool = False) -> Chart | None:
    rows = [row for row in curves if row.quantity == quantity]
    lines = dict.fromkeys((str(row.method), row.message) for row in rows)
    series = [
        Series(
            method if message is None else f"{method}: {message}",
            _points([row for row in rows if row.method == method and row.message == message]),
        )
        for method, message in lines
    ]
    return line_chart(title, series, logarithmic, axes=("iterations", ""))


def _points(rows: Sequence[MetricRow]) -> tuple[tuple[float, float], ...]:
    return tuple(sorted((row.iteration, row.value) for row in rows if row.iteration is not None))


def _stage_facts(record: LineageRecord) -> StageFacts:
    return StageFacts(
        record.name,
        record.uses,
        write_seconds(record.seconds),
        tuple((name, str(value)) for name, value in sorted(record.facts.items())),
        tuple((name, str(value)) for name, value in record.parameters.items()),
    )
