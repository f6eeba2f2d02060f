"""What a workflow says of a training arrives in its loop."""

from __future__ import annotations

from stages.training.parameters import TrainingParameters


def test_every_setting_arrives() -> None:
    stated = {
        "iterations": 123,
        "seed": 5,
        "schedule_share": 0.5,
        "averaging": 0.9,
        "opacity_weight": 1.0,
        "scale_weight": 2.0,
        "position_rate": 3.0,
        "final_position_rate": 0.3,
    }
    of_density = {"densify_gradient": 0.1, "maximum_gaussians": 77}
    settings = TrainingParameters.model_validate(stated | of_density).settings(7.0)
    assert {name: getattr(settings, name) for name in stated} == stated
    assert settings.extent == 7.0
    assert (settings.density.gradient_threshold, settings.density.maximum_gaussians) == (0.1, 77)
