"""Names of artifacts: what may be typed, and what is said if that names nothing or too much."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.errors import CommandError
from pipeline.results.naming import check_workflows, find_artifact, finding
from pipeline.store.store import Store
from tests.pipeline.helpers import CHAIN, Workspace

EACH = """
    name: each
    stages:
      base: {uses: numbers, with: {first: 7}}
      pair:
        foreach: {factor: [2, 3]}
        uses: scale
        in: {numbers: base}
        with: {factor: "${item.factor}"}
    """


@pytest.fixture
def folder(workspace: Workspace) -> Path:
    workspace.write(CHAIN).run()
    workspace.write(EACH).run()
    return workspace.folder / "store"


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("chain/twice.numbers", "chain/twice.numbers"),
        ("chain/twice", "chain/twice.numbers"),
        ("twice.numbers", "chain/twice.numbers"),
        ("twice", "chain/twice.numbers"),
        ("sum.page", "chain/sum.page"),
        ("pair[3]", "each/pair[3].numbers"),
        ("each/pair[2].numbers", "each/pair[2].numbers"),
        ("each/base", "each/base.numbers"),
    ],
)
def test_names_in_latest(folder: Path, text: str, name: str) -> None:
    artifact, store = find_artifact(text, folder)
    assert store is not None
    assert artifact.path == (folder / "latest" / name).resolve()


def test_a_whole_name_means_itself(workspace: Workspace) -> None:
    """If the stage had a foreach in between, the artifacts of its items are still there."""
    plain = "name: each\nstages:\n  pair: {uses: numbers}\n"
    workspace.write(plain).run()
    workspace.write(EACH).run()
    workspace.write(plain).run()
    artifact, _ = find_artifact("each/pair.numbers", workspace.folder / "store")
    assert artifact.path == (workspace.folder / "store" / "latest" / "each" / "pair.numbers").resolve()


def test_digests_and_paths(folder: Path, tmp_path: Path) -> None:
    artifact, _ = find_artifact("twice", folder)
    for text in (artifact.digest, artifact.digest[:12], str(artifact.path), str(folder / "latest/chain/twice.numbers")):
        found, store = find_artifact(text, folder)
        assert found.digest == artifact.digest
        assert store is not None
        assert store.root == folder
    elsewhere = tmp_path / "elsewhere"
    artifact.path.rename(elsewhere)
    assert find_artifact(str(elsewhere), tmp_path / "no store")[1] is None
    assert not (tmp_path / "no store").exists(), "looking makes no store"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("base", "choose one of chain/base.numbers, each/base.numbers"),
        ("sum", "choose one of chain/sum.key, chain/sum.page, chain/sum.total"),
        ("pair", r"choose one of each/pair\[2\].numbers, each/pair\[3\].numbers"),
        ("pair.numbers", r"choose one of each/pair\[2\]"),
        ("chain/twcie.numbers", "did you mean 'chain/twice.numbers'"),
        ("twise.numbers", "did you mean 'twice.numbers'"),
        ("abc", "6 or more characters of a digest"),
    ],
)
def test_what_is_not_clear(folder: Path, text: str, words: str) -> None:
    with pytest.raises(CommandError, match=words):
        find_artifact(text, folder)


def test_a_start_that_two_digests_share(folder: Path) -> None:
    digest = find_artifact("twice", folder)[0].digest
    twin = digest[:10] + ("0" if digest[10] != "0" else "1") * 54
    (folder / "objects" / twin).mkdir()
    with pytest.raises(CommandError, match=f"choose one of .*{digest[:12]} = chain/twice.numbers"):
        find_artifact(digest[:8], folder)


def test_what_an_earlier_run_made_is_to_be_had_again(workspace: Workspace) -> None:
    """After a run with a wrong folder, it must not look as if everything were lost."""
    ran = workspace.write(CHAIN).run()
    digest = ran.ended["sum"].outputs["total"].name[:12]
    twice = 'twice: {uses: scale, in: {numbers: base}, with: {factor: "${factor}"}}'
    workspace.write(CHAIN.replace(twice, "twice: {uses: fail, in: {numbers: base}}")).run()
    with pytest.raises(
        CommandError, match=rf"no artifact 'chain/sum\.total'.*failed in twice.* to restore the links.*{digest}"
    ):
        find_artifact("chain/sum.total", workspace.folder / "store")


@pytest.fixture
def folder_of_a_failure(workspace: Workspace) -> Path:
    """A store whose only run failed in `twice`, so that `sum` was skipped."""
    twice = 'twice: {uses: scale, in: {numbers: base}, with: {factor: "${factor}"}}'
    workspace.write(CHAIN.replace(twice, "twice: {uses: fail, in: {numbers: base}}")).run()
    return workspace.folder / "store"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("chain/sum", "In the last run of chain, sum was skipped: needs twice, which was not made"),
        ("chain/sum.numbers", "In the last run of chain, sum was skipped: needs twice, which was not made"),
        ("chain/twice.numbers", "In the last run of chain, twice failed: ZeroDivisionError: division by zero"),
    ],
)
def test_of_what_was_never_made_it_is_told_why(folder_of_a_failure: Path, text: str, words: str) -> None:
    with pytest.raises(CommandError) as refused:
        find_artifact(text, folder_of_a_failure)
    assert str(refused.value).endswith(f"'? {words}"), "after the nearest name that there is"


def test_a_typing_error_is_not_blamed_on_a_failed_run(folder_of_a_failure: Path) -> None:
    with pytest.raises(CommandError) as refused:
        find_artifact("chain/base.numbres", folder_of_a_failure)
    assert str(refused.value).endswith("; did you mean 'chain/base.numbers'?")


def test_no_store(tmp_path: Path) -> None:
    with pytest.raises(CommandError, match="no store there"):
        find_artifact("chain/twice", tmp_path / "nowhere")


def test_what_is_looked_at_is_not_deleted_meanwhile(folder: Path) -> None:
    store = Store(folder)
    with finding("twice", folder), pytest.raises(CommandError, match="using the store"), store.in_use(alone=True):
        pass


def test_workflows_that_ran(folder: Path) -> None:
    check_workflows(Store(folder), ["chain", "each"])
    with pytest.raises(CommandError, match="did you mean 'chain'"):
        check_workflows(Store(folder), ["chian"])
