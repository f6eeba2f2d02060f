"""Material of a page: everything for the owner, only public parts for everybody else.

The public page is made from public material only, so that no later step has to remember what to leave out. Three
filters apply in turn: to whole artifacts by their privacy, to rows and pictures by their subject, and to stages by what
they lead to. Even the methods' names are replaced, since some of them reveal their purpose.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from pipeline.artifact import Artifact
from pipeline.errors import UserError
from pipeline.stage import Item, LineageRecord
from stages.analysis.comparisons import Comparison, read_comparisons
from stages.analysis.method_titles import METHOD_TITLES
from stages.analysis.page.found import Found, read_found
from stages.analysis.page.placed import Placed, public_scenes, read_placed
from stages.analysis.videos import Video, read_videos
from stages.hiding.method_names import PLAIN
from stages.imaging.metric_table import MetricRow, read_rows

PUBLIC_QUANTITIES = frozenset(
    {"psnr", "ssim", "lpips_vgg", "lpips_alex", "container_bytes", "gaussians", "seconds_per_frame", "loss"}
)
PUBLIC_ROLES = frozenset({"cover"})
PUBLIC_FACTS = frozenset({"device"})
TELLING = ("cover", "message", "hid", "secret")
ACCEPTED, PUBLICLY_ACCEPTED = "accepted", "kept after a change of code"

Inputs = Mapping[str, Sequence[Artifact]]
"""Artifacts by input name: `scores`, `curves`, `timings`, `pictures`, `videos`, `public_scores`, `public_pictures`,
`public_videos`, and `figures` of `recover`."""


@dataclass(frozen=True)
class Material:
    """Input of a page. Methods have the names they are shown by; the first one scored is the page's subject."""

    scores: tuple[MetricRow, ...]
    curves: tuple[MetricRow, ...]
    pictures: tuple[Comparison, ...]
    lineage: tuple[LineageRecord, ...]
    videos: tuple[Video, ...] = ()
    placed: tuple[Placed, ...] = ()
    found: tuple[Found, ...] = ()

    @property
    def methods(self) -> tuple[str, ...]:
        """The methods that were scored, in the order of their first row."""
        return tuple(dict.fromkeys(str(row.method) for row in self.scores))

    @property
    def messages(self) -> tuple[str, ...]:
        """The messages that were scored, in the order of their first row."""
        return tuple(dict.fromkeys(row.message for row in self.scores if row.message is not None))


def owner_material(inputs: Inputs, lineage: Sequence[LineageRecord], scenes: Sequence[Item] = ()) -> Material:
    """All inputs of the stage, without duplicates; `scenes` are those whose numbers of placed photos are shown.

    Raises `UserError` if `scores` are of two containers of one method, which a page would take for one.
    """
    _check_containers(inputs["scores"])
    material = replace(_gathered(inputs, lineage), placed=read_placed(scenes), found=read_found(inputs["figures"]))
    return _named(material, lambda methods: {name: METHOD_TITLES.get(name, name) for name in methods})


def public_material(inputs: Inputs, lineage: Sequence[LineageRecord], scenes: Sequence[Item] = ()) -> Material:
    """The public parts of the same inputs."""
    public = {name: [artifact for artifact in given if not artifact.private] for name, given in inputs.items()}
    shown = {artifact.digest for given in public.values() for artifact in given}
    material = _gathered(public, public_lineage(lineage, shown))
    return _named(
        replace(
            material,
            scores=tuple(row for row in material.scores if is_public(row)),
            curves=tuple(row for row in material.curves if is_public(row)),
            pictures=tuple(each for each in material.pictures if each.role in PUBLIC_ROLES),
            videos=tuple(each for each in material.videos if each.role in PUBLIC_ROLES),
            placed=read_placed(public_scenes(scenes, public_stages(lineage, shown))),
        ),
        neutral_titles,
    )


def public_lineage(lineage: Sequence[LineageRecord], shown: Collection[str] = ()) -> tuple[LineageRecord, ...]:
    """The stages that lead to something public through public stages alone, with public facts only.

    A stage with any private output is left out, and so is a public one that only such stages use, unless an output of
    its own is `shown` (a digest): the photos of something that later becomes private reveal as much as the stage that
    makes it so. Also left out, as any of it may reveal a message or name a person: the parameters of a stage that takes
    input from an omitted one, and all others but numbers, yes or no, and null; the stages' own names, which may say
    what they serve ("cover"), with the columns of rows; and the modules that had changed when a result was accepted.
    """
    kept = public_stages(lineage, shown)
    names = _names_to_the_public([record for record in lineage if record.name in kept])
    return tuple(
        replace(
            _with_public_facts(record),
            name=names[record.name],
            inputs=tuple(names[name] for name in record.inputs if name in kept),
            parameters=_numbers(record.parameters) if all(name in kept for name in record.inputs) else {},
        )
        for record in lineage
        if record.name in kept
    )


def _numbers(parameters: Mapping[str, object]) -> dict[str, int | float | None]:
    """The parameters that are numbers, yes or no, or null, as texts may be names of folders or photos.

    Those whose own names tell of hiding are left out, too.
    """
    return {
        name: value
        for name, value in parameters.items()
        if (value is None or isinstance(value, int | float)) and not any(word in name for word in TELLING)
    }


def public_stages(lineage: Sequence[LineageRecord], shown: Collection[str] = ()) -> frozenset[str]:
    """Names of the stages that lead to something public, or `shown`, through public stages alone."""
    kept: set[str] = set()
    for record in reversed(lineage):
        consumers = [later.name for later in lineage if record.name in later.inputs]
        is_shown = any(digest in shown for digest in record.outputs)
        if not record.private and (is_shown or not consumers or any(name in kept for name in consumers)):
            kept.add(record.name)
    return frozenset(kept)


def _names_to_the_public(records: Sequence[LineageRecord]) -> dict[str, str]:
    """Public names of stages by their own names: their kind, with a number from the second of a kind on."""
    count = Counter[str]()
    found = {}
    for record in records:
        count[record.uses] += 1
        number = count[record.uses]
        found[record.name] = record.uses if number == 1 else f"{record.uses} {number}"
    return found


def _with_public_facts(record: LineageRecord) -> LineageRecord:
    facts = {name: value for name, value in record.facts.items() if name in PUBLIC_FACTS}
    if ACCEPTED in record.facts:
        facts[ACCEPTED] = PUBLICLY_ACCEPTED
    return replace(record, facts=facts)


def _check_containers(scores: Sequence[Artifact]) -> None:
    scored = {artifact.digest: {row.method for row in read_rows(artifact)} for artifact in scores}
    counts = Counter(method for methods in scored.values() for method in methods if method != PLAIN)
    for method, count in counts.items():
        if count > 1:
            raise UserError(
                f"a report is about one container of each method, and {count} of `scores` are of {method!r}",
                remedy="Use `tabulate`, whose page has a row for each, or give the stage `foreach` with their rows.",
            )


def _gathered(inputs: Inputs, lineage: Sequence[LineageRecord]) -> Material:
    scores = [row for name in ("scores", "public_scores") for each in inputs[name] for row in read_rows(each)]
    first = next((row.method for row in scores if row.method is not None), None)
    timings = [replace(row, method=row.method or first) for each in inputs["timings"] for row in read_rows(each)]
    curves = [
        replace(row, method=row.method or f"training {number}")
        for number, each in enumerate(inputs["curves"], start=1)
        for row in read_rows(each)
    ]
    pictures: dict[tuple[str, str, str], Comparison] = {}
    for artifact in (*inputs["pictures"], *inputs["public_pictures"]):
        for each in read_comparisons(artifact):
            pictures.setdefault((each.method, each.role, each.title), each)
    videos: dict[tuple[str, str, str], Video] = {}
    for artifact in (*inputs["videos"], *inputs["public_videos"]):
        for video in read_videos(artifact):
            videos.setdefault((video.method, video.role, video.title), video)
    return Material(
        tuple(dict.fromkeys((*scores, *timings))),
        tuple(curves),
        tuple(pictures.values()),
        tuple(lineage),
        tuple(videos.values()),
    )


def _named(material: Material, titles_of: Callable[[Iterable[str]], Mapping[str, str]]) -> Material:
    rows = (*material.scores, *material.curves)
    shown = [*(each.method for each in material.pictures), *(each.method for each in material.videos)]
    titles = titles_of(dict.fromkeys((*(str(row.method) for row in rows), *shown)))
    return replace(
        material,
        scores=tuple(replace(row, method=titles[str(row.method)]) for row in material.scores),
        curves=tuple(replace(row, method=titles[str(row.method)]) for row in material.curves),
        pictures=tuple(replace(each, method=titles[each.method]) for each in material.pictures),
        videos=tuple(replace(each, method=titles[each.method]) for each in material.videos),
    )


def neutral_titles(methods: Iterable[str]) -> dict[str, str]:
    """A title for each method that does not reveal the method's purpose."""
    titles = {PLAIN: METHOD_TITLES[PLAIN]}
    for name in methods:
        if name not in titles:
            titles[name] = "This scene" if len(titles) == 1 else f"Scene {len(titles)}"
    return titles


def is_public(row: MetricRow) -> bool:
    """Whether anyone with the published splats and the photos can measure this."""
    return row.message is None and row.quantity in PUBLIC_QUANTITIES
