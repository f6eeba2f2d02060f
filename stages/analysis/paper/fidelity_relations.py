"""What Table 1 should show: the paper's ranking, and that our method is better by as much as its best rival."""

from __future__ import annotations

import math
from collections.abc import Sequence

from stages.analysis.method_titles import DECODER, GS_HIDER, OURS, SECOND_HARMONICS
from stages.analysis.paper.chapter import noises, of_method, title_of
from stages.analysis.paper.measuring import Figure, cover, message, size
from stages.analysis.paper.published import Published, Subject, average, row_of
from stages.analysis.paper.relations import Relation
from stages.analysis.paper.runs import Run, Study
from stages.hiding.method_names import PLAIN

MOST_LOST_ON_THE_COVER = 1.4
LARGEST_SHARE_OF_BYTES = 0.6


def paper_relations(runs: Sequence[Run], study: Study, tables: Published) -> list[Relation]:
    """The ranking of Table 1: GS-Hider above both baselines, not far below 3DGS, and smaller."""
    spreads = noises(runs, study)
    pictures: tuple[tuple[Subject, Figure], ...] = (("cover", cover("psnr")), ("message", message("psnr")))
    found = []
    for subject, figure in pictures:
        for rival in (SECOND_HARMONICS, DECODER):
            found.append(
                Relation(
                    f"{title_of(GS_HIDER)} above {title_of(rival)} on the {subject}",
                    "difference",
                    "more than",
                    0.0,
                    of_method(runs, GS_HIDER, figure).minus(of_method(runs, rival, figure)),
                    average(row_of(tables, GS_HIDER, subject, "psnr"))
                    - average(row_of(tables, rival, subject, "psnr")),
                    spreads[subject],
                )
            )
    plain, hider = tables.fidelity[PLAIN], tables.fidelity[GS_HIDER]
    return [
        *found,
        Relation(
            f"{title_of(GS_HIDER)} not far below 3DGS on the cover",
            "difference",
            "at least",
            -MOST_LOST_ON_THE_COVER,
            of_method(runs, GS_HIDER, cover("psnr")).minus(of_method(runs, PLAIN, cover("psnr"))),
            average(hider.cover) - average(plain.cover),
            spreads["cover"],
        ),
        Relation(
            f"{title_of(GS_HIDER)}'s bytes, including decoders, over those of 3DGS",
            "ratio",
            "at most",
            LARGEST_SHARE_OF_BYTES,
            of_method(runs, GS_HIDER, size).over(of_method(runs, PLAIN, size)),
            (hider.megabytes or math.nan) / (plain.megabytes or math.nan),
        ),
    ]


def own_relations(runs: Sequence[Run], study: Study, tables: Published) -> list[Relation]:
    """Our method compared with GS-Hider, with at least the rival's gain in no more bytes, and compared with 3DGS."""
    spreads, hider, rival = noises(runs, study), tables.fidelity[GS_HIDER], tables.rival
    gains: tuple[tuple[Subject, Figure, float], ...] = (
        ("cover", cover("psnr"), rival.cover - average(hider.cover)),
        ("message", message("psnr"), rival.message - average(hider.message)),
    )
    name = title_of(OURS)
    return [
        *(
            Relation(
                f"{name} above {title_of(GS_HIDER)} on the {subject} by the rival's margin",
                "difference",
                "at least",
                gain,
                of_method(runs, OURS, figure).minus(of_method(runs, GS_HIDER, figure)),
                gain,
                spreads[subject],
                rival.name,
            )
            for subject, figure, gain in gains
        ),
        Relation(
            f"{name} above 3DGS on the cover",
            "difference",
            "more than",
            0.0,
            of_method(runs, OURS, cover("psnr")).minus(of_method(runs, PLAIN, cover("psnr"))),
            rival.cover - average(tables.fidelity[PLAIN].cover),
            spreads["cover"],
            rival.name,
        ),
        Relation(
            f"{name}'s bytes over those of {title_of(GS_HIDER)}",
            "ratio",
            "at most",
            1.0,
            of_method(runs, OURS, size).over(of_method(runs, GS_HIDER, size)),
        ),
    ]
