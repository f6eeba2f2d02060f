"""What stages publish holds nothing secret, for each method with a secret; test_main_job.py checks a whole run.

Only 3DGS+SH is not here: its container holds the message itself, and its secret only the message's name.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.artifact import Artifact
from pipeline.stage import Item
from stages.add_grain import AddGrainParameters, add_grain
from stages.compare_with_paper import CompareWithPaperParameters, compare_with_paper
from stages.draw_key import DrawKeyParameters, draw_key
from stages.evaluate import EvaluateParameters, evaluate
from stages.export_container import ExportContainerParameters, export_container
from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.report import ReportParameters, report
from stages.seal import SealParameters, seal
from tests.running import run_stage
from tests.stages.small import message_views, scene
from tests.workflows.secret_windows import SecretWindows, everything_in, pieces_of


@pytest.mark.parametrize("method", ["gs_hider", "homogeneous", "decoder"])
def test_what_stages_publish_holds_no_piece_of_a_secret(tmp_path: Path, method: str) -> None:
    cover, messages = scene(tmp_path / "cover"), (message_views(tmp_path / "views"),)
    key = run_stage(draw_key, DrawKeyParameters(), {}, tmp_path / "key")["key"]
    hiding = HideScenesParameters.model_validate({"method": method, "iterations": 3, "decoder_width": 12})
    hidden = run_stage(hide_scenes, hiding, {"cover": cover, "messages": messages, "key": key}, tmp_path / "hidden")
    grain_key = run_stage(draw_key, DrawKeyParameters(), {}, tmp_path / "grain_key")["key"]
    given = {"container": hidden["container"], "secret": hidden["secret"], "cover": cover, "key": grain_key}
    grain = run_stage(add_grain, AddGrainParameters(method=method), given, tmp_path / "grain")
    pair = run_stage(
        seal, SealParameters(method=method), {**grain, "secret": hidden["secret"], "key": key}, tmp_path / "sealed"
    )
    made = [
        hidden,
        grain,
        pair,
        scores := run_stage(
            evaluate,
            EvaluateParameters(method=method, lpips="none"),
            {**pair, "cover": cover, "messages": messages},
            tmp_path / "scores",
        ),
        bundles := run_stage(
            export_container, ExportContainerParameters(), pair | {"cover": cover}, tmp_path / "files"
        ),
        reports(scores, hidden["curves"], tmp_path / "report"),
        tables(scores, tmp_path / "tables"),
    ]
    windows = SecretWindows(piece for artifact in (hidden["secret"], key, grain_key) for piece in pieces_of(artifact))
    public = [artifact for outputs in made for artifact in outputs.values() if not artifact.private]
    assert "cameras.json" in bundles["bundle"].files
    assert {artifact.kind for artifact in public} >= {"container", "bundle", "report", "metrics", "comparisons"}
    held = {name for artifact in public for name, data in everything_in(artifact) if windows.first_in(data) is not None}
    assert not held
    found = [name for name, data in everything_in(bundles["secret_bundle"]) if windows.first_in(data) is not None]
    assert any(name.endswith(".safetensors") for name in found), "the search would not have found it"


def reports(scores: dict[str, Artifact], curves: Artifact, folder: Path) -> dict[str, Artifact]:
    inputs = {name: (artifact,) for name, artifact in scores.items()}
    return run_stage(report, ReportParameters(), {**inputs, "curves": (curves,)}, folder)


def tables(scores: dict[str, Artifact], folder: Path) -> dict[str, Artifact]:
    inputs = {name: (scores[name],) for name in ("scores", "public_scores")}
    items = {name: (Item(name, {"capture": "fox"}, name, *given),) for name, given in inputs.items()}
    return run_stage(compare_with_paper, CompareWithPaperParameters(), inputs, folder, items=items)
