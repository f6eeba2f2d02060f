"""What a training compares, and how its curves score it."""

from __future__ import annotations

import torch

from stages.training.objectives import Compared, PictureTerm


def test_a_trainings_psnr_is_of_the_picture_as_it_is_shown() -> None:
    """There it is clamped to [0, 1]; in the loss it is not."""
    truth = torch.tensor([0.0, 1.0])[:, None, None].expand(2, 4, 3)
    shown = Compared(PictureTerm("cover", 1.0, 0.2), 2 * truth - 0.5, truth)
    assert shown.squared_error() == 0
    assert Compared(shown.term, truth.flip(0), truth).squared_error() == 1
