"""The lens with which structure from motion starts, and the views held out of its scene."""

from __future__ import annotations

from stages.scene.capture import Capture
from stages.scene.scene import held_out_by_number
from stages.scene.structure_from_motion import starting_lens


def test_a_focal_length_is_that_of_the_size_at_which_photos_are_matched() -> None:
    capture = Capture(("a.jpg", "b.jpg"), ((4000, 3000),) * 2, (3000.0, None), ordered=False)
    known, guessed = (starting_lens(capture, row, (1600, 1200), "SIMPLE_RADIAL") for row in (0, 1))
    assert known.parameters == (1200.0, 800.0, 600.0, 0.0)
    assert (known.width, known.height) == (1600, 1200)
    assert guessed.parameters[1:] == known.parameters[1:]
    assert guessed.parameters[0] == 1.2 * 1600


def test_every_eighth_view_is_held_out_from_the_first_on() -> None:
    names = [f"{number:02}" for number in range(17)]
    assert held_out_by_number(names[::-1]) == ("00", "08", "16")
    assert held_out_by_number(names[:8]) == ("00",)
