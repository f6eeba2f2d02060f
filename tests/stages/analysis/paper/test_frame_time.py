"""The chapter on rendering times says what its figures and the paper's include."""

from __future__ import annotations

from stages.analysis.paper.frame_time import frame_time
from stages.analysis.paper.published import read_published
from stages.analysis.paper.runs import Run, Settings, Study
from stages.imaging.metric_table import MetricRow


def test_the_papers_times_are_said_to_include_the_message_decoder() -> None:
    timed = MetricRow("seconds_per_frame", 0.02, "s", method="gs_hider")
    study = Study((), timings=(Run("fox", "gs_hider", (), "0", (timed,)),))
    [grid] = frame_time(study, read_published()).grids
    [note] = grid.notes
    assert "its code also runs the message decoder" in note
    assert note.endswith("decode the cover alone.")


def test_the_reference_has_the_usual_settings() -> None:
    """Plain 3DGS with fewer Gaussians is faster, and not what others are compared with."""

    def timed(method: str, seconds: float, settings: Settings = ()) -> Run:
        row = MetricRow("seconds_per_frame", seconds, "s", method=method)
        return Run("fox", method, settings, "0", (row,))

    fewer = (("gaussians", 15_000.0),)
    study = Study((), timings=(timed("plain", 0.010), timed("plain", 0.002, fewer), timed("gs_hider", 0.020)))
    [grid] = frame_time(study, read_published()).grids
    [line] = [line for line in grid.lines if line.names[0] == "GS-Hider" and not line.published]
    assert line.cells[-1].text == "+10.0"
