"""Containers of owners have a key each, so that a secret that is passed on reads only one container."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.console.project import open_project
from pipeline.plan.loss import is_read
from pipeline.workflow.graph import Graph, Node

WORKFLOWS = Path(__file__).parents[2] / "workflows"
FOR_OWNERS = {
    "hide_photos": ("cover", "message"),
    "hide_picture": ("cover", "picture"),
    "hide_edits": ("cover",),
    "hide_splats": ("cover", "message"),
    "trace_pictures": ("cover", "pictures"),
    "batch_pairs": (),
}
MAKE_CONTAINERS = {"hide_scenes", "hide_image", "add_grain"}


def nodes(tmp_path: Path, store: Path, workflow: str) -> dict[str, Node]:
    return dict(graph(tmp_path, store, workflow).nodes)


def graph(tmp_path: Path, store: Path, workflow: str, *more: str) -> Graph:
    for name in ("one", "two", "three"):
        (tmp_path / name).mkdir(exist_ok=True)
        (tmp_path / name / "a.jpg").write_bytes(b"1")
    settings = [f"{variable}={tmp_path / 'one'}" for variable in FOR_OWNERS[workflow]]
    if workflow == "batch_pairs":
        pairs = [f"{{cover: {tmp_path}/{cover}, message: {tmp_path}/three}}" for cover in ("one", "two")]
        settings = [f"pairs=[{', '.join(pairs)}]"]
    return open_project(WORKFLOWS / f"{workflow}.yaml", store, [*settings, *more]).graph


@pytest.mark.parametrize("workflow", FOR_OWNERS)
def test_a_key_depends_on_all_that_its_container_holds(tmp_path: Path, store: Path, workflow: str) -> None:
    found = nodes(tmp_path, store, workflow)
    makers = [node for node in found.values() if node.uses in MAKE_CONTAINERS]
    assert makers
    for maker in makers:
        (key,) = maker.sources["key"]
        held = {source for name in ("cover", "messages", "image") for source in maker.sources.get(name, ())}
        if maker.uses == "add_grain":
            held = {*maker.sources["container"]}
        assert held <= {*found[key.node].sources["container_of"]}


@pytest.mark.parametrize("workflow", FOR_OWNERS)
def test_gaussians_from_before_the_grain_are_private(tmp_path: Path, store: Path, workflow: str) -> None:
    """Compared with the published ones, they reveal how every coin fell."""
    found = nodes(tmp_path, store, workflow)
    for maker in (node for node in found.values() if node.uses == "add_grain"):
        (before,) = maker.sources["container"]
        assert found[before.node].private


def test_pairs_of_a_batch_have_a_key_each(tmp_path: Path, store: Path) -> None:
    makers = [node for node in nodes(tmp_path, store, "batch_pairs").values() if node.uses == "hide_scenes"]
    assert len({maker.sources["key"] for maker in makers}) == len(makers) == 2


@pytest.mark.parametrize("level", [0, 1.5])
@pytest.mark.parametrize("workflow", [name for name in FOR_OWNERS if name != "trace_pictures"])
def test_a_key_is_read_but_that_of_no_grain(tmp_path: Path, store: Path, workflow: str, level: float) -> None:
    """Owners are told if another key takes its place, but not bothered about a key with which nothing was made."""
    found = graph(tmp_path, store, workflow, f"grain={level}")
    keys = {name: is_read(name, found) for name, node in found.nodes.items() if node.unrepeatable}
    of_grains = {name: read for name, read in keys.items() if found.nodes[name].entry == "grain_key"}
    assert set(of_grains.values()) == {level > 0}
    others = keys.keys() - of_grains.keys()
    assert others
    assert all(keys[name] for name in others)


def test_a_key_by_which_pictures_are_told_is_read(tmp_path: Path, store: Path) -> None:
    found = graph(tmp_path, store, "trace_pictures", "grain=0")
    assert [is_read(name, found) for name, node in found.nodes.items() if node.unrepeatable] == [True]
