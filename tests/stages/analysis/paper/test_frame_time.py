"""The chapter on rendering times says what its figures and the paper's include."""

from __future__ import annotations

from stages.analysis.paper.frame_time import frame_time
from stages.analysis.paper.published import read_published
from stages.analysis.paper.runs import Run, Study
from stages.imaging.metric_table import MetricRow


def test_the_papers_times_are_said_to_include_the_message_decoder() -> None:
    timed = MetricRow("seconds_per_frame", 0.02, "s", method="gs_hider")
    study = Study((), timings=(Run("fox", "gs_hider", (), "0", (timed,)),))
    [grid] = frame_time(study, read_published()).grids
    [note] = grid.notes
    assert "its code also runs the message decoder" in note
    assert note.endswith("decode the cover alone.")
