"""Only what a secret names counts as hidden, and an image only where the cover has the view that hides it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from pipeline.artifact import Artifact, create, load
from pipeline.errors import UserError
from stages.hiding.image_view import IMAGE_VIEW
from stages.hiding.what_is_hidden import (
    at_least_one_hidden,
    hidden_messages,
    messages_to_read,
    view_of_an_image,
    view_that_hides,
)
from stages.scene.message_views import read_messages
from stages.scene.scene import read_scene
from tests.stages import small


def secret(folder: Path, messages: Sequence[str], view: str | None = None) -> Artifact:
    with create(folder, "secret", private=True) as writer:
        writer.attributes.update(messages=[*messages], **({IMAGE_VIEW: view} if view else {}))
    return load(folder)


def test_of_the_messages_that_are_given_those_that_are_hidden_count(tmp_path: Path) -> None:
    views = [small.message_views(tmp_path / name, name) for name in ("reef", "statue")]
    given = read_messages(views, small.NAMES)
    hides = secret(tmp_path / "one", ["statue", "another"])
    assert list(hidden_messages(given, hides)) == ["statue"]
    assert hidden_messages(given, None) == {}
    with pytest.raises(UserError, match="hides none of the messages; found a secret of 1 others") as told:
        at_least_one_hidden(given, secret(tmp_path / "others", ["another"]), "reveal")
    assert "another" not in str(told.value)


def test_messages_that_a_secret_does_not_fit_are_not_passed_over(tmp_path: Path) -> None:
    given = read_messages([small.message_views(tmp_path / "statue", "statue")], small.NAMES)
    with pytest.raises(UserError, match="cannot be read without the secret; found messages, but no secret"):
        messages_to_read(given, None, "evaluate")
    with pytest.raises(UserError, match="hides none of the messages"):
        messages_to_read(given, secret(tmp_path / "others", ["another"]), "evaluate")
    assert list(messages_to_read(given, secret(tmp_path / "own", ["statue"]), "evaluate")) == ["statue"]
    nothing, image = secret(tmp_path / "nothing", []), secret(tmp_path / "image", ["boat"], small.NAMES[2])
    assert [messages_to_read(given, each, "evaluate") for each in (nothing, image)] == [{}, {}]
    assert messages_to_read({}, None, "evaluate") == {}


def test_an_image_is_where_the_cover_has_the_view_that_hides_it(tmp_path: Path) -> None:
    cover = read_scene(small.scene(tmp_path / "scene"))
    here = secret(tmp_path / "here", ["boat"], small.NAMES[2])
    elsewhere = secret(tmp_path / "elsewhere", ["boat"], "of another cover.png")
    of_scenes = secret(tmp_path / "scenes", ["boat"])
    assert view_of_an_image(here, cover, "evaluate") == small.NAMES[2] == view_that_hides("boat", here, cover, "reveal")
    assert view_of_an_image(of_scenes, cover, "evaluate") is None
    assert view_of_an_image(None, cover, "evaluate") is None
    with pytest.raises(UserError, match="not in this cover"):
        view_of_an_image(elsewhere, cover, "evaluate")
    with pytest.raises(UserError, match="not the image that is hidden"):
        view_that_hides("mark", here, cover, "reveal")
