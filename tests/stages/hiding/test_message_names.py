"""A message cannot have a name that the pages or the methods use for something else."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from stages.hiding.message_names import MessageName
from stages.image import ImageParameters
from stages.render_hidden import RenderHiddenParameters


@pytest.mark.parametrize("parameters", [RenderHiddenParameters, ImageParameters])
@pytest.mark.parametrize("name", ["cover", "Cover", "loss", "feature map", "feature_map", " side  by side", ""])
def test_a_name_that_is_taken_is_refused(
    parameters: type[RenderHiddenParameters | ImageParameters], name: MessageName
) -> None:
    with pytest.raises(ValidationError, match=r"another name|at least 1"):
        parameters(name=name)


@pytest.mark.parametrize("name", ["two\nlines", "caf\udce9", "x" * 301])
def test_a_name_that_no_bundle_could_hold_is_refused(name: str) -> None:
    with pytest.raises(ValidationError):
        RenderHiddenParameters(name=name)


def test_others_are_kept_as_they_are() -> None:
    assert RenderHiddenParameters(name="Cover of a book").name == "Cover of a book"
