"""Nobody can guess a key, unless an experiment asks for one that can be drawn again."""

from __future__ import annotations

from pathlib import Path

from pipeline.artifact import Artifact
from stages.draw_key import DrawKeyParameters, draw_key
from tests.running import run_stage


def drawn(folder: Path, seed: int | None) -> Artifact:
    return run_stage(draw_key, DrawKeyParameters(seed=seed), {}, folder)["key"]


def test_without_a_seed_every_key_is_another_and_a_lost_one_does_not_come_back(tmp_path: Path) -> None:
    keys = [drawn(tmp_path / str(number), None) for number in range(3)]
    assert len({key.digest for key in keys}) == 3
    assert all(key.private for key in keys)
    assert draw_key.unrepeatable is not None
    assert draw_key.unrepeatable(DrawKeyParameters())


def test_with_a_seed_it_is_the_same_again(tmp_path: Path) -> None:
    first, again, other = (drawn(tmp_path / name, seed) for name, seed in (("a", 0), ("b", 0), ("c", 1)))
    assert first.digest == again.digest != other.digest
    assert draw_key.unrepeatable is not None
    assert not draw_key.unrepeatable(DrawKeyParameters(seed=0))
