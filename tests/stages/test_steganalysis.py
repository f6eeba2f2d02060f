"""From containers to the page: renders of each class, what detectors find in them, and what the page says."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.artifact import Artifact, create, load
from pipeline.errors import UserError
from pipeline.stage import Item
from stages.analysis.attribute_histograms import DIVERGENCE, ONLY_THERE, of_attribute
from stages.analysis.learned_detection import LEARNED, TRAINING_PAIRS, TRAINING_SCENES
from stages.analysis.measurements import Measurement, read_measurements, write_measurements
from stages.analysis.picture_classes import CLEAN, CLEAN_AGAIN, HIDDEN, PHOTOS, stegexpose_rows
from stages.analysis.renders import Renders, collect_renders, read_renders, write_renders
from stages.analysis.stegexpose.fusion import DETECTORS, FUSION, stegexpose
from stages.compare_attributes import CompareAttributesParameters, compare_attributes
from stages.compare_with_paper import CompareWithPaperParameters, compare_with_paper
from stages.detect_hidden import DetectHiddenParameters, detect_hidden
from stages.hiding.method import build_method
from stages.hiding.rendering import COVER, Rendering
from stages.hiding.storage import write_container
from stages.render_views import RenderViewsParameters, render_views
from stages.scene.gaussians import gaussians_at
from stages.steganalysis import SteganalysisParameters, steganalysis
from tests.running import run_stage
from tests.stages import small

VIEWS = 6


def container(folder: Path, method: str = "gs_hider", seed: int = 0, shade: float = 0.3) -> Artifact:
    torch.manual_seed(seed)
    messages = ["statue"]
    settings: dict[str, object] = {"feature_dim": 8, "layers": 2, "decoder_width": 8, "precision": "float32"}
    built = build_method(method, (settings if method == "gs_hider" else {"sh_degree": 1}) | {"messages": messages})
    colors = {COVER: np.full((60, 3), shade), "statue": np.full((60, 3), 0.7)}
    attributes = built.initial_attributes(colors, np.random.default_rng(seed))
    with create(folder, "container") as writer:
        write_container(writer, gaussians_at(small.points(), attributes), built)
    return load(folder)


def rendered(folder: Path, of: Artifact, cover: Artifact, method: str = "gs_hider", **parameters: int) -> Artifact:
    chosen = RenderViewsParameters(method=method, **{"views": VIEWS, "feature_maps": 2, "threads": 1, **parameters})
    return run_stage(render_views, chosen, {"container": of, "cover": cover}, folder)["renders"]


def test_renders_are_of_the_same_new_cameras_and_need_no_secret(tmp_path: Path) -> None:
    cover = small.scene(tmp_path / "cover")
    first, second = (
        read_renders(rendered(tmp_path / f"renders{seed}", container(tmp_path / f"c{seed}", seed=seed), cover))
        for seed in (0, 1)
    )
    assert first.view_names == second.view_names
    assert first.pictures.shape == (VIEWS, small.HEIGHT, small.WIDTH, 3)
    assert len(np.unique(first.pictures, axis=0)) == VIEWS
    assert first.feature_maps.shape == (2, small.HEIGHT, small.WIDTH, 8)
    assert set(first.feature_map_names) < set(first.view_names)
    without = read_renders(rendered(tmp_path / "sh", container(tmp_path / "s", "sh"), cover, "sh"))
    assert without.feature_maps.shape == (0, small.HEIGHT, small.WIDTH, 0)


def test_every_picture_of_every_class_is_looked_at(tmp_path: Path) -> None:
    cover = small.scene(tmp_path / "cover")
    renders = {
        name: rendered(tmp_path / name, container(tmp_path / f"of_{name}", seed=seed), cover)
        for seed, name in enumerate(("hidden", "clean"))
    }
    assert not renders["hidden"].private
    made = run_stage(steganalysis, SteganalysisParameters(), {"cover": cover, **renders}, tmp_path / "out")
    assert made["measurements"].private
    rows = read_measurements(made["measurements"])
    counts = {name: sum((row.condition, row.quantity) == (name, FUSION) for row in rows) for name in (PHOTOS, HIDDEN)}
    assert counts == {PHOTOS: small.VIEWS, HIDDEN: VIEWS}
    assert {row.condition for row in rows} == {PHOTOS, HIDDEN, CLEAN}
    pictures = read_renders(renders["clean"]).pictures
    found = {row.quantity: row.value for row in rows if row.condition == CLEAN and row.view == "0000"}
    assert found == pytest.approx(stegexpose(pictures[0]), nan_ok=True)
    assert set(found) == {*DETECTORS, FUSION}


def test_classes_of_odd_pictures_are_not_told_by_their_size() -> None:
    odd = np.random.default_rng(0).integers(0, 256, (1, 25, 33, 3)).astype(np.uint8)
    found = {row.quantity: row.value for row in stegexpose_rows(odd, ["a"], PHOTOS, "sh")}
    assert found == pytest.approx(stegexpose(odd[0, :24, :32]), nan_ok=True)
    assert not np.isnan(found["sample_pairs"])


def stored_renders(folder: Path, seed: int, amplitude: float, method: str = "gs_hider") -> Artifact:
    """Smooth pictures and feature maps; `amplitude` is added to every other pixel."""
    generator = np.random.default_rng(seed)
    rows, columns = np.mgrid[0:24, 0:32]
    slopes = generator.uniform(-2, 2, (VIEWS, 5, 2))
    values = 128 + slopes[..., :1, None] * (rows - 12) + slopes[..., 1:, None] * (columns - 16)
    values = values + generator.normal(0, 0.5, values.shape) + amplitude * ((rows + columns) % 2)
    values = values.clip(0, 255).transpose(0, 2, 3, 1)
    names = tuple(f"{view:04d}" for view in range(VIEWS))
    maps = (values / 255).astype(np.float16)
    with create(folder, "renders") as writer:
        write_renders(writer, Renders(method, names, values[..., :3].astype(np.uint8), names, maps))
    return load(folder)


def items(folder: Path, captures: Sequence[str], amplitude: float, column: str = "seed") -> tuple[Item, ...]:
    folder.mkdir(parents=True)
    return tuple(
        Item(
            f"{n}_{capture}",
            {"cover": capture, "method": "gs_hider", column: n},
            "renders",
            stored_renders(folder / f"{n}_{capture}", n, amplitude),
        )
        for n, capture in enumerate(captures)
    )


def detected(
    folder: Path,
    captures: Sequence[str],
    capture: str,
    method: str = "gs_hider",
    seed: int = 0,
    iterations: int = 15,
    column: str = "seed",
) -> tuple[Measurement, ...]:
    """Detections in rows that differ in this column."""
    given = {
        "hidden": items(folder / "hidden", captures, 8, column),
        "clean": items(folder / "clean", captures, 0, column),
        "clean_again": items(folder / "again", captures, 0, column),
    }
    parameters = DetectHiddenParameters(capture=capture, method=method, iterations=iterations, seed=seed)
    inputs = {name: tuple(item.artifact for item in each if item.artifact) for name, each in given.items()}
    made = run_stage(detect_hidden, parameters, inputs, folder / "out", items=given)
    assert made["measurements"].private
    return read_measurements(made["measurements"])


def test_a_detector_learns_from_other_scenes_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It reads one view at a time: at the paper's size, all views of nine captures are 77 GB."""

    def read(self: Artifact, name: str) -> np.ndarray:
        raise AssertionError(f"all of {name} is read")

    monkeypatch.setattr(Artifact, "read", read)
    rows = detected(tmp_path, ["fox", "kitchen"], "fox")
    assert [row.value for row in rows if row.quantity == TRAINING_SCENES] == [1]
    for quantity in LEARNED:
        logits = {
            name: [row.value for row in rows if (row.quantity, row.condition) == (quantity, name)]
            for name in (HIDDEN, CLEAN, CLEAN_AGAIN)
        }
        assert all(len(each) == VIEWS for each in logits.values())
        assert np.mean(logits[HIDDEN]) > np.mean(logits[CLEAN])
        assert logits[CLEAN_AGAIN] == logits[CLEAN]


def test_another_seed_is_another_detector(tmp_path: Path) -> None:
    first, again, second = (
        [row.value for row in detected(tmp_path / name, ["fox", "kitchen"], "fox", seed=seed)]
        for name, seed in (("first", 0), ("again", 0), ("second", 1))
    )
    assert first == again != second


def test_each_training_of_a_scene_is_looked_at_by_itself(tmp_path: Path) -> None:
    """By one detector, which learnt from the other scenes."""
    rows = detected(tmp_path / "both", ["fox", "fox", "kitchen"], "fox")
    assert [row.value for row in rows if row.quantity == TRAINING_SCENES] == [1]
    views = [(row.seed, row.view) for row in rows if (row.quantity, row.condition) == ("learned_on_renders", HIDDEN)]
    assert views == [(training, f"{view:04d}") for training in (0, 1) for view in range(VIEWS)]


@pytest.mark.parametrize("column", ["feature_dim", "own"])
def test_variants_of_a_method_are_not_mixed(tmp_path: Path, column: str) -> None:
    with pytest.raises(UserError, match=f"0_fox and 1_fox: .* several variants.* found different {column};"):
        detected(tmp_path / "mixed", ["fox", "fox", "kitchen"], "fox", column=column)
    assert detected(tmp_path / "one_each", ["fox", "kitchen"], "fox", iterations=1, column=column)
    assert detected(tmp_path / "others", ["fox", "fox"], "fox", method="sh", column=column) == ()


def test_trainings_of_one_scene_are_one_scene_to_learn_from(tmp_path: Path) -> None:
    rows = detected(tmp_path / "learnt", ["fox", "kitchen", "kitchen", "bonsai"], "fox", iterations=1)
    counts = {row.quantity: row.value for row in rows if row.quantity in (TRAINING_SCENES, TRAINING_PAIRS)}
    assert counts == {TRAINING_SCENES: 2, TRAINING_PAIRS: 3}
    text = written(tmp_path / "several", [measured(tmp_path / "fox", rows, "fox", "gs_hider")], ())
    assert "on 2 other scene(s), with one or more containers and as many clean trainings of each:" in text
    one = [row for row in rows if row.quantity != TRAINING_PAIRS]
    text = written(tmp_path / "single", [measured(tmp_path / "as_before", one, "fox", "gs_hider")], ())
    assert "on 2 other scene(s), with one container and one clean training of each:" in text


def test_renders_are_collected_where_they_stay() -> None:
    """Stacking would hold them in memory twice."""
    pixels, channels, views = torch.zeros(64, 64), 8, 32

    def renderings() -> Iterator[Rendering]:
        for _ in range(views):
            yield Rendering(
                {COVER: pixels[..., None].expand(64, 64, 3)},
                torch.zeros(64, 64, channels),
                pixels,
                torch.empty(0, dtype=torch.int32),
                torch.empty(0, 2),
            )

    names = [str(view) for view in range(views)]
    tracemalloc.start()
    renders = collect_renders("gs_hider", names, renderings(), 16)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(renders.feature_map_names) == len(renders.feature_maps) == 16
    assert most < 1.3 * (np.asarray(renders.pictures).nbytes + np.asarray(renders.feature_maps).nbytes)


def test_nothing_to_learn_from_or_to_test_is_no_error(tmp_path: Path) -> None:
    alone = detected(tmp_path / "one", ["fox"], "fox")
    assert {row.quantity: row.value for row in alone} == {TRAINING_SCENES: 0, TRAINING_PAIRS: 0}
    assert detected(tmp_path / "none", ["fox"], "kitchen") == ()
    assert detected(tmp_path / "other", ["fox"], "fox", method="sh") == ()


@pytest.fixture(scope="module", autouse=True)
def folders(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Use one thread: small pictures are not worth more."""
    torch.set_num_threads(1)


def test_attributes_that_only_a_container_has_are_counted(tmp_path: Path) -> None:
    hidden, clean = container(tmp_path / "hidden", "sh"), small.splats(tmp_path / "clean")
    given = {"hidden": hidden, "clean": clean, "clean_again": clean}
    made = run_stage(compare_attributes, CompareAttributesParameters(method="sh"), given, tmp_path / "out")
    rows = {(row.quantity, row.condition): row.value for row in read_measurements(made["measurements"])}
    assert rows[ONLY_THERE, HIDDEN] == 2
    assert rows[ONLY_THERE, CLEAN_AGAIN] == 0
    assert rows[of_attribute(DIVERGENCE, "sh_base"), CLEAN_AGAIN] == 0
    assert rows[of_attribute(DIVERGENCE, "sh_base"), HIDDEN] > 0.9


def measured(folder: Path, rows: Sequence[Measurement], capture: str, method: str) -> Item:
    folder.mkdir(parents=True)
    with create(folder / "measurements", "measurements", private=True) as writer:
        write_measurements(writer, rows)
    return Item(method, {"cover": capture, "method": method}, "stegexpose", load(folder / "measurements"))


def written(folder: Path, given: Sequence[Item], captures: Sequence[str] = ("All captures", "fox")) -> str:
    parameters = CompareWithPaperParameters(tables=("steganalysis",), capture_column="cover")
    made = run_stage(
        compare_with_paper,
        parameters,
        {"experiments": tuple(item.artifact for item in given if item.artifact)},
        folder,
        items={"experiments": tuple(given)},
    )
    page = made["owner"].file("report.html").read_text(encoding="utf-8")
    assert all(f"{capture}: renders that hide, against photos" in page for capture in captures)
    return made["owner"].file("tables.md").read_text(encoding="utf-8")


def rows_of(values: Mapping[str, np.ndarray], method: str) -> list[Measurement]:
    return [
        Measurement(detector, float(value), condition, view=str(view), method=method)
        for condition, each in values.items()
        for view, value in enumerate(each)
        for detector in (*DETECTORS, FUSION)
    ]


def test_the_page_tells_rendering_from_hiding(tmp_path: Path) -> None:
    """Both methods' renders differ fully from photos; so do clean renders of one method, but not of the other."""
    low, high = np.linspace(0, 0.3, 40), np.linspace(0.5, 0.8, 40)
    rendering = {PHOTOS: high, HIDDEN: low, CLEAN: low, CLEAN_AGAIN: low}
    hiding = {PHOTOS: low, HIDDEN: high, CLEAN: low, CLEAN_AGAIN: low}
    learnt = [Measurement(TRAINING_SCENES, 1, HIDDEN)] + [
        Measurement("learned_on_renders", value, condition, view=str(view))
        for condition, each in {HIDDEN: high, CLEAN: low, CLEAN_AGAIN: low}.items()
        for view, value in enumerate(each)
    ]
    attributes = [
        Measurement(ONLY_THERE, 2, HIDDEN),
        Measurement("gaussians", 1.5, HIDDEN),
        Measurement("gaussians", 0.9, CLEAN_AGAIN),
    ]
    given = [
        measured(tmp_path / capture / method, rows_of(values, method), capture, method)
        for capture in ("fox", "kitchen")
        for method, values in (("decoder", hiding), ("gs_hider", rendering))
    ]
    given += [measured(tmp_path / "more" / str(n), each, "fox", "sh") for n, each in enumerate((learnt, attributes))]
    text = written(tmp_path / "out", given)
    verdict = "Renders with and without a message:"
    assert f"what is detected is mostly that they are renders. {verdict} not distinguished" in text
    assert f"what is detected is more than rendering. {verdict} distinguished" in text
    assert "| 3DGS+SH | not measured | distinguished | not measured | attributes that no clean file has: 2 |" in text
    assert "|  | renders | two that hide nothing, against each other | 0.50 (0.50 to 0.50)" in text
    assert "1.500 (0.900)" in text
    lines = [line for line in text.splitlines() if "renders that hide, against photos" in line]
    assert "1.00 (1.00 to 1.00) | 1.00 (1.00 to 1.00) | 1.00 (1.00 to 1.00)" in lines[0]
    assert "1.00 (1.00 to 1.00 ↓)" in lines[1]
    assert "3DGS+Decoder: two-sided area of StegExpose, renders that hide against renders that do not" in text
    assert "does not hold" in text
    assert "40 | 40" in text
