"""Figures of attacked containers: over which losses of the cover methods are compared, and with which settings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import pytest

from stages.analysis.attacks.catalogue import ATTACKS, UNATTACKED
from stages.analysis.measurements import Measurement
from stages.analysis.paper.chapter import Chapter
from stages.analysis.paper.grid import Grid
from stages.analysis.paper.published import read_published
from stages.analysis.paper.robustness import robustness
from stages.analysis.paper.runs import Experiment, Settings, Study

COVER, MESSAGE = 31.0, 26.0
STEPS = 4
LINE = "What is left of the message, as found"


def cropped(method: str, reaches: Sequence[float], settings: Settings = (), capture: str = "fox") -> Experiment:
    """A container whose message loses 2 dB for each dB of the cover, up to this loss of the cover with each seed."""

    def row(condition: str, severity: float | None, seed: int | None, loss: float) -> Iterator[Measurement]:
        for value, name in ((COVER - loss, None), (MESSAGE - 2 * loss, "statue")):
            yield Measurement("psnr", value, condition, severity, seed, None, "test", name, method)

    rows = [*row(UNATTACKED, None, None, 0.0)]
    for seed, reach in enumerate(reaches):
        for step in range(1, STEPS + 1):
            rows += row("cropping", step / STEPS, seed, reach * step / STEPS)
    return Experiment(capture, method, "0", tuple(rows), {}, "attacked", settings)


def chapter_of(*experiments: Experiment) -> Chapter:
    return robustness(Study((), experiments=experiments), read_published())


def areas(chapter: Chapter) -> Grid:
    [grid] = [grid for grid in chapter.grids if grid.caption.startswith(LINE)]
    return grid


def left(chapter: Chapter) -> Mapping[str, str]:
    """The texts of the line on cropping, by column."""
    grid = areas(chapter)
    [line] = [line for line in grid.lines if line.names == (ATTACKS["cropping"].title,)]
    return {heading: cell.text for heading, cell in zip(grid.headings, line.cells, strict=True)}


WEIGHT: Settings = (("lambda_message", 0.5),)
SEALED: Settings = (("sealed", "True"),)
BOTH_WEIGHTED = (cropped("homogeneous", [0.8], WEIGHT), cropped("homogeneous", [0.8], (*WEIGHT, *SEALED)))


@pytest.mark.parametrize(
    "experiments",
    [
        (cropped("gs_hider", [4.0]), *BOTH_WEIGHTED),
        (cropped("gs_hider", [4.0]), cropped("homogeneous", [4.0]), cropped("homogeneous", [0.8], SEALED)),
        (
            cropped("gs_hider", [0.8], (("lambda_message", 0.1),)),
            cropped("gs_hider", [0.8], (("lambda_message", 0.3),)),
            cropped("homogeneous", [4.0]),
        ),
    ],
    ids=["another weight, sealed or not", "the usual weight, sealed or not", "two weights of GS-Hider"],
)
def test_whatever_the_settings_equal_curves_leave_equally_much(experiments: tuple[Experiment, ...]) -> None:
    found = dict(left(chapter_of(*experiments)))
    assert found.pop("Cover's loss up to") == "0.80 dB"
    assert set(found.values()) == {"25.20"}
    assert len(found) == len(experiments)


def test_all_of_ours_are_held_against_all_of_gs_hider() -> None:
    hiders = [cropped("gs_hider", [4.0], (("lambda_message", weight),)) for weight in (0.1, 0.3)]
    chapter = chapter_of(*hiders, *BOTH_WEIGHTED)
    compared = [each.text for each in chapter.relations if "by more than the spread, as found" in each.text]
    ours = [f"Homogeneous GS-Hider, λ = 0.5{sealed}" for sealed in ("", ", sealed")]
    assert set(compared) == {
        f"{own} not below GS-Hider, λ = {weight} by more than the spread, as found: cropping out"
        for own in ours
        for weight in (0.1, 0.3)
    }
    notes = [note for grid in chapter.grids for note in grid.notes if "loses more of its message than GS-Hider" in note]
    assert len(set(notes)) == 4


def test_our_weakest_point_is_that_of_all_of_ours() -> None:
    both = (cropped("homogeneous", [0.8], WEIGHT), cropped("homogeneous", [1.5], (*WEIGHT, *SEALED)))
    tile, _ = chapter_of(cropped("gs_hider", [4.0]), *both).tiles
    assert (tile.label, tile.value) == ("Our weakest point, as found", "1.50 dB")
    assert tile.note.startswith("Homogeneous GS-Hider, λ = 0.5, sealed, cropping")
    alone, _ = chapter_of(cropped("homogeneous", [0.8])).tiles
    assert alone.note.startswith("cropping")


def test_one_seed_that_hardly_costs_the_cover_anything_hides_no_loss() -> None:
    """The severities are those of the first seed; on average over three, the last costs the cover 2.68 dB."""
    chapter = chapter_of(cropped("gs_hider", [4.0, 4.0, 4.0]), cropped("homogeneous", [4.0, 4.0, 0.04]))
    found = left(chapter)
    assert found["Cover's loss up to"] == "2.68 dB"
    assert found["GS-Hider"].startswith("23.32")
    assert found["Homogeneous GS-Hider"].startswith("23.32"), "equal lines leave equally much"
    [relation] = [each for each in chapter.relations if "by more than the spread, as found" in each.text]
    assert relation.measured.on("fox") == pytest.approx(0.0, abs=1e-9)


def test_a_capture_whose_cover_loses_little_leaves_the_others_their_width() -> None:
    reaches = {("gs_hider", "fox"): 4.0, ("gs_hider", "bonsai"): 4.0, ("homogeneous", "fox"): 4.0}
    reaches["homogeneous", "bonsai"] = 0.8
    chapter = chapter_of(*(cropped(method, [reach], (), capture) for (method, capture), reach in reaches.items()))
    found = left(chapter)
    assert found["Cover's loss up to"] == "0.80 to 4.00 dB"
    assert found["GS-Hider"] == found["Homogeneous GS-Hider"] == "23.60", "the mean of 22.00 and 25.20"
    assert "The smallest width is 0.80 dB: cropping out, bonsai." in areas(chapter).notes


def permuted(method: str, messages: Sequence[Sequence[float]], covers: Sequence[Sequence[float]] = ()) -> Experiment:
    """A container with these PSNRs of the message, and of the cover if it is not spared, by seed and severity."""
    rows = [Measurement("psnr", COVER, UNATTACKED, None, None, None, "test", None, method)]
    rows.append(Measurement("psnr", MESSAGE, UNATTACKED, None, None, None, "test", "statue", method))
    for seed, found in enumerate(messages):
        for step, message in enumerate(found):
            cover = covers[seed][step] if covers else COVER
            for value, name in ((cover, None), (message, "statue")):
                rows.append(
                    Measurement("psnr", value, "channel_permutation", float(step + 1), seed, None, "test", name, method)
                )
    return Experiment("fox", method, "0", tuple(rows), {}, "attacked")


def of_permutation(chapter: Chapter, caption: str) -> tuple[str, str]:
    """Text and note of our cell in the line on permutation."""
    [grid] = [grid for grid in chapter.grids if grid.caption.startswith(caption)]
    [line] = [line for line in grid.lines if line.names == (ATTACKS["channel_permutation"].title,)]
    cell = line.cells[grid.headings.index("Homogeneous GS-Hider")]
    return cell.text, cell.note


def test_what_is_gained_at_no_cost_is_what_is_lost_whichever_severity_is_worst_for_a_seed() -> None:
    messages = [(MESSAGE - 3, MESSAGE - 9), (MESSAGE - 8, MESSAGE - 4)]
    chapter = chapter_of(permuted("homogeneous", messages), permuted("gs_hider", messages))
    assert of_permutation(chapter, LINE)[0].startswith("19.50 ± ")
    assert of_permutation(chapter, LINE)[1] == "-6.50, n = 2"
    assert of_permutation(chapter, "What attackers gain, as found")[0].startswith("6.50 ± ")


def test_a_seed_whose_cover_is_never_rendered_is_not_counted() -> None:
    nan = float("nan")
    messages = [(MESSAGE - 3,), (MESSAGE - 5,), (MESSAGE,)]
    covers = [(COVER,), (COVER,), (nan,)]
    chapter = chapter_of(permuted("homogeneous", messages, covers), permuted("gs_hider", messages, covers))
    assert of_permutation(chapter, LINE) == ("22.00 ± 1.41", "-4.00, n = 2")
    assert of_permutation(chapter, "What attackers gain, as found") == ("4.00 ± 1.41", "n = 2")
