"""Robustness: the paper's two prunings beside its figures, and every attack as a curve of message over cover."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import product

from stages.analysis.attacks.catalogue import ATTACKS, UNATTACKED, AttackName, restored
from stages.analysis.method_titles import DECODER, GS_HIDER, OURS, SECOND_HARMONICS
from stages.analysis.page.chart import Chart, Series, line_chart
from stages.analysis.page.figures import MISSING
from stages.analysis.page.summary import Tile
from stages.analysis.paper.attack_curves import POINTS, Reading, average_curve, measured, severities
from stages.analysis.paper.attacked import LEAST_WIDTH, Attacked
from stages.analysis.paper.chapter import Chapter, title_of
from stages.analysis.paper.grid import Cell, Grid, Line, average_cell, signed, some_of, without_empty_columns
from stages.analysis.paper.measuring import Measured, Spread, mean
from stages.analysis.paper.pruning_table import pruning_relations, pruning_table
from stages.analysis.paper.published import Published
from stages.analysis.paper.purification import floor_notes, purification
from stages.analysis.paper.relations import Relation
from stages.analysis.paper.runs import Experiment, Study, by_method, capture_title
from stages.hiding.method_names import PLAIN

WRITTEN = 0.005
"""In dB: smaller differences are not visible in the tables."""

POINT_HEADINGS = tuple(f"Point {number}" for number in range(1, POINTS + 1))

CURVE_NOTE = (
    "At each loss of the cover, the attacker takes, among the severities that cost the cover no more, the one that "
    "leaves least of the message. So an attack that destroys the message and spares the cover is a vertical drop, and "
    "counts over the whole width. A loss of the cover of up to 0.05 dB counts as none. All seeds of an attack have the "
    "severities of the first: at each severity, cover and message are means over the seeds. On each capture, the width "
    "is the largest loss of the cover that all curves of GS-Hider and of ours reach, with any settings (of all "
    f"methods, where neither has one), but at least {LEAST_WIDTH:g} dB. Curves that end before continue level, which "
    "favours them if a stronger attack would take more: those of other methods, and those of attacks that hardly "
    "change a cover. A message that reads worse than the best single-colour picture is gone, and an owner who sees it "
    "says so: it counts as such a picture. A seed with which a view of the cover can no longer be rendered does not "
    "count at that severity. ±: over n seeds of the attack, by leaving out each in turn; for several captures, that of "
    "their mean."
)

READINGS: Mapping[Reading, str] = {
    "as found": "as found",
    "registered": "after registration with the published container",
}
"""How captions describe the container that is read."""

REGISTERED_NOTE = (
    "The owner, who does not know the attack, searches for a motion of the world and a map of the features that bring "
    "the found container back to the published one, undoes both, and reads again. At every point the better of the two "
    "readings counts, since the owner knows what was hidden. Renders cannot be registered."
)

SEALED_NOTE = (
    "Sealed: attacked as it is published. The owner opens what is left of it by means of what was published, even "
    "before registration: of several Gaussians that were one, such as clones, only one counts, and what the scene "
    "decoder reads of a feature is taken as published, so that no attack on features harms that part. The other "
    "methods' containers are not opened in this way."
)


def robustness(study: Study, tables: Published) -> Chapter:
    """The chapter on the measurements of `attack`."""
    attacked = _attacked(study)
    if not attacked.by_method:
        return Chapter("Robustness", ())
    sources = ", ".join(dict.fromkeys(each.stage for group in attacked.by_method.values() for each in group))
    grids = (
        pruning_table(attacked.by_method, tables),
        *(_areas(attacked, reading, sources) for reading in READINGS),
        *(_gains(attacked, reading) for reading in READINGS),
        purification(attacked, tables),
        _points(attacked),
        _registered_points(attacked),
    )
    return Chapter(
        "Robustness",
        tuple(grid for grid in map(without_empty_columns, grids) if grid.lines),
        (
            *pruning_relations(attacked.by_method, tables),
            *(relation for reading in READINGS for relation in _relations(attacked, reading)),
        ),
        tiles=tuple(tile for reading in READINGS for tile in _tiles(attacked, reading)),
        charts=tuple(chart for attack in attacked.attacks if (chart := _chart(attacked, attack)) is not None),
    )


def _attacked(study: Study) -> Attacked:
    conditions = {*ATTACKS, UNATTACKED}
    of_attacks = [each for each in study.experiments if {row.condition for row in each.rows} & conditions]
    found = {row.condition for each in of_attacks for row in each.rows}
    return Attacked(by_method(of_attacks), tuple(attack for attack in ATTACKS if attack in found))


def _areas(attacked: Attacked, reading: Reading, sources: str) -> Grid:
    lines = []
    for attack in attacked.attacks:
        cells = []
        for method, (first, *_) in attacked.by_method.items():
            lost = attacked.message_lost(method, attack, reading).average.mean
            note = signed("psnr", -lost)
            left = attacked.message_left(method, attack, reading)
            cells.append(_cell(attack, first.method, left, attacked.captures, note))
        lines.append(Line((ATTACKS[attack].title,), (*cells, _width_cell(attacked.widths(attack)))))
    cells = [average_cell("psnr", _unattacked(group), attacked.captures) for group in attacked.by_method.values()]
    return Grid(
        f"What is left of the message, {READINGS[reading]}: PSNR (dB), averaged over the cover's loss",
        ("Attack",),
        (*attacked.titles, "Cover's loss up to"),
        (Line(("No attack",), (*cells, Cell(""))), *lines),
        (
            CURVE_NOTE,
            *_smallest_width(attacked),
            "Second figures: difference from what was read before the attack. A method that starts with a better "
            "message can lose more of it and still have more left.",
            *_lost_by_ours(attacked, reading),
            *_notes(attacked, reading),
            f"All figures: means over test views, from the measurements of {sources}.",
        ),
    )


def _width_cell(widths: Mapping[str, float]) -> Cell:
    """The smallest and the largest width of any capture; as a figure for other programs, their mean."""
    ends = dict.fromkeys(f"{width:.2f}" for width in (min(widths.values()), max(widths.values())))
    return Cell(f"{' to '.join(ends)} dB", "", Spread(mean(widths.values())))


def _smallest_width(attacked: Attacked) -> Iterator[str]:
    """In words, under which attack and on which capture curves are compared least far, if they are compared at all."""
    found = (
        (width, attack, capture) for attack in attacked.attacks for capture, width in attacked.widths(attack).items()
    )
    smallest = min(found, key=lambda each: each[0], default=None)
    if smallest is not None:
        width, attack, capture = smallest
        yield f"The smallest width is {width:.2f} dB: {_sentence(attack)}, {capture_title(capture)}."


def _notes(attacked: Attacked, reading: Reading) -> Iterator[str]:
    if reading == "registered":
        yield REGISTERED_NOTE
    if attacked.is_any_sealed:
        yield SEALED_NOTE


def _lost_by_ours(attacked: Attacked, reading: Reading) -> list[str]:
    """In words, under how many attacks our message loses more than GS-Hider's, by more than tables show."""
    found = []
    for ours, hider in _pairs(attacked):
        lost = [[attacked.message_lost(each, attack, reading) for each in (ours, hider)] for attack in attacked.attacks]
        excess = [own.minus(other).average.mean for own, other in lost if own.minus(other).by_capture]
        count = f"{sum(each > WRITTEN for each in excess)} of {len(excess)}"
        if excess:
            found.append(f"{title_of(ours)} loses more of its message than {title_of(hider)} under {count} attacks.")
    return found


def _pairs(attacked: Attacked) -> list[tuple[str, str]]:
    """Each of our kinds with each of GS-Hider's."""
    return list(product(attacked.kinds(OURS), attacked.kinds(GS_HIDER)))


def _unattacked(experiments: Sequence[Experiment]) -> Measured:
    """The message before any attack, counted as after attacks: no worse than the best single colour."""
    return measured(experiments, UNATTACKED, "as found", lambda curve: curve.unattacked.message)


def _cell(attack: AttackName, method: str, figure: Measured, captures: Collection[str], note: str = "") -> Cell:
    """A figure's average, or the reason why there is none."""
    if not figure.by_capture:
        return Cell(ATTACKS[attack].needs if _is_spared(attack, method) else MISSING)
    return average_cell("psnr", figure, captures, note)


def _is_spared(attack: AttackName, method: str) -> bool:
    """Whether the method's containers have nothing that the attack acts on."""
    if attack in ("jpeg", "resizing"):
        return method != DECODER
    if attack == "stripping":
        return method in (PLAIN, DECODER)
    return bool(ATTACKS[attack].needs) and method in (PLAIN, SECOND_HARMONICS, DECODER)


def _gains(attacked: Attacked, reading: Reading) -> Grid:
    lines = [
        Line(
            (ATTACKS[attack].title,),
            tuple(
                _cell(attack, first.method, attacked.gain(method, attack, reading), attacked.captures)
                for method, (first, *_) in attacked.by_method.items()
            ),
        )
        for attack in attacked.attacks
    ]
    caps = tuple(_cap(attacked, method) for method in attacked.by_method)
    weakest = [
        f"{title_of(method)} is weakest under {_sentence(attack)} ({gain:.2f} dB): {ATTACKS[attack].hurts}."
        for method, attack, gain in _weakest(attacked, attacked.by_method, reading)
    ]
    return Grid(
        f"What attackers gain, {READINGS[reading]}: the message's loss minus the cover's, at the best severity (dB)",
        ("Attack",),
        attacked.titles,
        (Line(("Most it can lose",), caps), *lines),
        (
            *weakest,
            "Above 0, the message suffers more than the cover; below, the attacker loses the cover first.",
            *floor_notes(attacked),
            *_notes(attacked, reading),
        ),
    )


def _cap(attacked: Attacked, method: str) -> Cell:
    return average_cell("psnr", attacked.most_to_lose(method), attacked.captures)


def _weakest(attacked: Attacked, methods: Iterable[str], reading: Reading) -> Iterator[tuple[str, AttackName, float]]:
    """Yield each method that any attack gains on, the attack that gains most, and its gain in dB."""
    for method in methods:
        gains = {attack: attacked.gain(method, attack, reading).average.mean for attack in attacked.attacks}
        known = {attack: gain for attack, gain in gains.items() if gain > 0}
        if known:
            worst = max(known, key=lambda attack: known[attack])
            yield method, worst, known[worst]


def _sentence(attack: AttackName) -> str:
    title = ATTACKS[attack].title
    return title if title[:2].isupper() else title[0].lower() + title[1:]


def _points(attacked: Attacked) -> Grid:
    """The table of everything that is drawn."""
    lines = []
    for attack in attacked.attacks:
        for method, group in attacked.by_method.items():
            curve = average_curve(group, attack)
            if curve is not None:
                title, severe = _title(attacked, method, attack), _severities(group, attack)
                covers, messages = ([point.cover for point in curve.points], [point.message for point in curve.points])
                for picture, stated, values in (("Cover", severe, covers), ("Message", "", messages)):
                    cells = [Cell(f"{value:.2f}", "", Spread(value)) for value in values]
                    names = ATTACKS[attack].title, f"{title} · {picture}"
                    lines.append(Line(names, (Cell(stated), *_filled(cells))))
    meanings = "; ".join(f"{ATTACKS[attack].title} by {ATTACKS[attack].severity}" for attack in attacked.attacks)
    return Grid(
        "The points of the curves: PSNR of cover and message (dB)",
        ("Attack", "Picture"),
        ("Severities", *POINT_HEADINGS),
        tuple(lines),
        (
            "Means over captures at equal shares of the largest loss that each cover reaches, from none to all of it, "
            "interpolated along the lines that bound the areas, which join the measured points, means over seeds. "
            "Messages count as read, even where that is worse than one colour. In brackets: how many severities were "
            f"measured on each container, or on that with the fewest. Severities: {meanings}.",
        ),
    )


def _registered_points(attacked: Attacked) -> Grid:
    """The table of everything that was read after registration, better or worse than before."""
    lines = []
    for attack in attacked.attacks:
        for method, group in attacked.by_method.items():
            both = [each for each in group if severities([each], restored(attack))]
            found, registered = average_curve(both, attack), average_curve(both, attack, restored(attack))
            if found is not None and registered is not None:
                cells = [
                    Cell(f"{after.message:.2f}", f"from {before.message:.2f}", Spread(after.message))
                    for before, after in zip(found.points, registered.points, strict=True)
                ]
                lines.append(Line((ATTACKS[attack].title, _title(attacked, method, attack)), _filled(cells)))
    return Grid(
        f"The message at every point, {READINGS['registered']}: PSNR (dB)",
        ("Attack", "Method"),
        POINT_HEADINGS,
        tuple(lines),
        ("As read at the points above, including readings that got worse; second figures are those as found.",),
    )


def _title(attacked: Attacked, method: str, attack: AttackName) -> str:
    """The method's title, with the number of captures if its curve is not over all of them."""
    some = some_of(attacked.message_left(method, attack, "as found"), attacked.captures)
    return f"{title_of(method)} ({some})" if some else title_of(method)


def _severities(experiments: Sequence[Experiment], attack: AttackName) -> str:
    """The smallest and the largest severity, and how many were measured on the container with the fewest, as text."""
    found = severities(experiments, attack)
    ends = dict.fromkeys(f"{severity:.3g}" for severity in (*found[:1], *found[-1:]))
    fewest = min((len(own) for each in experiments if (own := severities([each], attack))), default=0)
    return f"{' to '.join(ends)} ({fewest})"


def _filled(cells: Sequence[Cell]) -> tuple[Cell, ...]:
    return (*cells, *(Cell("") for _ in range(POINTS - len(cells))))


def _relations(attacked: Attacked, reading: Reading) -> list[Relation]:
    """For each attack: our areas, with any settings, are below GS-Hider's by no more than the seeds' spread."""
    found = (_not_worse(attacked, *pair, attack, reading) for attack in attacked.attacks for pair in _pairs(attacked))
    return [relation for relation in found if relation.measured.by_capture]


def _not_worse(attacked: Attacked, ours: str, hider: str, attack: AttackName, reading: Reading) -> Relation:
    """The relation for one attack; its bound is the deviation of the average over the captures that both have."""
    areas = [attacked.message_left(each, attack, reading) for each in (ours, hider)]
    difference = areas[0].minus(areas[1])
    deviations = [area.by_capture[each].deviation for area in areas for each in difference.by_capture]
    known = [deviation for deviation in deviations if not math.isnan(deviation)]
    allowed = math.hypot(*known) / len(difference.by_capture) if known else 0.0
    return Relation(
        f"{title_of(ours)} not below {title_of(hider)} by more than the spread, {reading}: {_sentence(attack)}",
        "difference",
        "at least",
        -allowed,
        difference,
    )


def _tiles(attacked: Attacked, reading: Reading) -> tuple[Tile, ...]:
    """The largest gain over all of our containers; its note names the kind if that is not the usual one."""
    found = max(_weakest(attacked, attacked.kinds(OURS), reading), key=lambda each: each[2], default=None)
    if found is None:
        return ()
    method, attack, gain = found
    of_kind = "" if method == OURS else f"{title_of(method)}, "
    explained = f"{of_kind}{_sentence(attack)}: message loss minus cover loss"
    return (Tile(f"Our weakest point, {reading}", f"{gain:.2f} dB", explained),)


def _chart(attacked: Attacked, attack: AttackName) -> Chart | None:
    series = []
    for method, group in attacked.by_method.items():
        curve = average_curve(group, attack)
        drawn = (*curve.points, curve.unattacked) if curve is not None else ()
        series.append(Series(title_of(method), tuple(sorted((point.cover, point.message) for point in drawn))))
    return line_chart(
        ATTACKS[attack].title, series, from_zero=False, axes=("PSNR of the cover (dB)", "PSNR of the message (dB)")
    )
