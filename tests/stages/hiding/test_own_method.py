"""A method of one's own is one file: it is trained, scored and attacked, and declares what the paper's methods do."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from pydantic import ValidationError

import stages.hiding.methods
from pipeline.artifact import create, load
from pipeline.errors import UserError
from stages.analysis.attacks.features import channel_permutation, feature_mixing
from stages.analysis.attacks.target import Target
from stages.analysis.measurements import read_measurements
from stages.analysis.secrecy.readers import has_start
from stages.attack import AttackParameters, attack
from stages.evaluate import EvaluateParameters, evaluate
from stages.hide_image import HideImageParameters
from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.hiding.key import KEY_BYTES, write_key
from stages.hiding.method import build_method
from stages.hiding.method_names import method_names
from stages.hiding.rendering import COVER
from stages.imaging.metric_table import read_rows
from tests.running import run_stage
from tests.stages.analysis.attacks.containers import shown, target_and_owner
from tests.stages.small import message_views, scene

SOURCE = '''
"""Feature maps read by linear layers, of which `levels` are hidden ones."""

import torch

from stages.hiding.coupled import COUPLED_SETTINGS, FEATURES, CoupledFeatures

SETTINGS = (*COUPLED_SETTINGS, "levels")
PRESETS = {"decoder_width": 12, "averaging": 0.5}
SCENE_PRESETS = {"lambda_message": 0.25}


class Shift(torch.nn.Module):
    """Draws its weight as it is built, and cannot draw it anew."""

    def __init__(self):
        super().__init__()
        self.shift = torch.nn.Parameter(torch.randn(1))

    def forward(self, values):
        return values + self.shift


class Own(CoupledFeatures):
    name = "own"

    def __init__(self, levels, **settings):
        self.levels = levels
        super().__init__(**settings)
        self.settings = {**self.settings, "levels": levels}

    def make_decoder(self, pictures, layers, width, kernel_size):
        hidden = [module for _ in range(self.levels) for module in (torch.nn.Linear(width, width), torch.nn.ReLU())]
        return torch.nn.Sequential(
            torch.nn.Linear(self.feature_dim, width), *hidden, torch.nn.Linear(width, 3 * pictures), Shift()
        )

    def initial_attributes(self, colors, generator):
        count = len(next(iter(colors.values())))
        return {FEATURES: torch.from_numpy(generator.normal(size=(count, self.feature_dim))).float()}

    def decoded(self, decoders, rendering, camera):
        return [decoder(rendering.feature_map) for decoder in decoders]


def build(settings):
    return Own(**settings)
'''
WITH_TABLE = """

def with_table(method):
    method.networks["table"] = torch.nn.Linear(1, 1)
    return method
"""
READS_OPACITY = '''
"""GS-Hider whose decoders read one input more: the blended opacity."""

import torch

from stages.hiding.coupled import COUPLED_SETTINGS, FEATURES
from stages.hiding.decoders import Decoder, decode
from stages.hiding.methods.gs_hider import GSHider

SETTINGS = COUPLED_SETTINGS


class Own(GSHider):
    name = "own"

    def make_decoder(self, pictures, layers, width, kernel_size):
        return Decoder(self.feature_dim + 1, 3 * pictures, layers, width, kernel_size)

    def initial_attributes(self, colors, generator):
        count = len(next(iter(colors.values())))
        return {FEATURES: torch.from_numpy(generator.normal(size=(count, self.feature_dim))).float()}

    def decoded(self, decoders, rendering, camera):
        seen = torch.cat([rendering.feature_map, rendering.alphas[..., None]], dim=-1)
        return [decode(decoder, seen, self.precision) for decoder in decoders]


def build(settings):
    return Own(**settings)
'''
COUPLED = {"feature_dim": 8, "layers": 2, "decoder_width": 12, "kernel_size": 3, "precision": "float32"}
SMALL = {"method": "own", "own_settings": {"levels": 1}, "iterations": 4, "feature_dim": 8}


@pytest.fixture
def own(tmp_path: Path) -> Iterator[Path]:
    """The file of a method that is found among the others."""
    folder = tmp_path / "methods"
    folder.mkdir()
    (folder / "own.py").write_text(SOURCE)
    stages.hiding.methods.__path__.append(str(folder))
    yield folder / "own.py"
    stages.hiding.methods.__path__.remove(str(folder))
    for name in ("own", "Mine"):
        sys.modules.pop(f"stages.hiding.methods.{name}", None)


def test_it_is_trained_scored_and_attacked(tmp_path: Path, own: Path) -> None:
    cover, views = scene(tmp_path / "cover"), message_views(tmp_path / "views")
    parameters = HideScenesParameters.model_validate(SMALL)
    made = run_stage(hide_scenes, parameters, {"cover": cover, "messages": (views,)}, tmp_path / "made")
    inputs = {"container": made["container"], "secret": made["secret"], "cover": cover, "messages": (views,)}
    scores = run_stage(evaluate, EvaluateParameters(method="own", lpips="none"), inputs, tmp_path / "scores")["scores"]
    assert {row.method for row in read_rows(scores)} == {"own"}
    turned = ("unread_directions", "channel_permutation", "feature_mixing", "compensated_rotation")
    features = ("channel_dropping", *turned, "rigid_motion")
    quick = {"method": "own", "attacks": features, "cover_losses": (0.5,), "seeds": (0,), "lpips": False}
    attacked = run_stage(attack, AttackParameters.model_validate(quick), inputs, tmp_path / "attacked")["measurements"]
    conditions = {row.condition.partition(",")[0] for row in read_measurements(attacked)}
    assert {"channel_dropping", "rigid_motion"} <= conditions
    assert not {*turned} & conditions, "it cannot be turned"


@pytest.mark.parametrize(("attacked", "severity"), [(channel_permutation, 16.0), (feature_mixing, 0.4)])
def test_a_scene_decoder_follows_features_beside_which_it_reads_more(
    own: Path, attacked: Callable[[Target, float, torch.Generator], Target], severity: float
) -> None:
    own.write_text(READS_OPACITY)
    target, _ = target_and_owner("own")
    changed = attacked(target, severity, torch.Generator().manual_seed(0))
    cover = shown(target, target.method)[COVER]
    assert float((shown(changed, target.method)[COVER] - cover).abs().max()) > 0.05, "the features did change"
    assert float((shown(changed, changed.method)[COVER] - cover).abs().max()) < 1e-4


def test_it_says_what_it_takes(own: Path) -> None:
    parameters = HideScenesParameters.model_validate(SMALL)
    assert (parameters.decoder_width, parameters.averaging, parameters.lambda_message) == (12, 0.5, 0.25)
    assert HideScenesParameters.model_validate({**SMALL, "decoder_width": 20}).decoder_width == 20
    assert HideImageParameters.model_validate(SMALL).lambda_message == 0.1, "those of scenes are not an image's"
    assert "own" in method_names()


def test_its_message_decoder_has_no_start_but_random_weights(own: Path) -> None:
    assert not has_start(build_method("own", {**COUPLED, "levels": 1}))
    assert has_start(build_method("gs_hider", COUPLED))


def test_every_layer_starts_from_the_key(tmp_path: Path, own: Path) -> None:
    parameters = HideScenesParameters.model_validate(SMALL)

    def weights(byte: int) -> dict[str, np.ndarray]:
        with create(tmp_path / str(byte), "key", private=True) as writer:
            write_key(writer, bytes([byte]) * KEY_BYTES)
        key = load(tmp_path / str(byte))
        network = parameters.build_method(["statue"], key).networks["message_decoder"]
        return {name: tensor.numpy() for name, tensor in network.state_dict().items()}

    first, other = weights(1), weights(2)
    assert not [name for name, values in first.items() if np.array_equal(values, other[name])]


@pytest.mark.parametrize(
    ("changed", "complaint"),
    [
        ({"own_settings": {}}, "should have exactly these keys for the method own: levels"),
        ({"own_settings": {"levels": 1, "depth": 2}}, "should have exactly these keys for the method own: levels"),
        ({"own_settings": {"levels": 100_000}}, "numbers up to 1024"),
        ({"own_settings": {"levels": True}}, "levels is neither"),
        ({"own_settings": {"levels": None}}, "levels is neither"),
        ({"method": "gs_hider"}, "should have exactly these keys for the method gs_hider: none"),
        ({"method": "plain", "own_settings": {}}, "should be one that hides"),
        ({"method": "owned"}, "'gs_hider', 'homogeneous', 'own', 'plain' or 'sh'"),
    ],
)
def test_what_it_does_not_take_is_refused(own: Path, changed: dict[str, object], complaint: str) -> None:
    with pytest.raises(ValidationError, match=complaint):
        HideScenesParameters.model_validate({**SMALL, **changed})


@pytest.mark.parametrize(
    ("source", "complaint"),
    [
        ("def build(:", "own: a method cannot be loaded; found SyntaxError"),
        ("import nothing_of_that_name", "found ModuleNotFoundError: No module named 'nothing_of_that_name'"),
        ("SETTINGS = ()", "a method cannot be built; expected a function build"),
        ("def build(settings): pass", "SETTINGS = None; expected a tuple of names"),
        ('SETTINGS = ("levels")\ndef build(settings): pass', "SETTINGS = 'levels'; expected a tuple of names"),
        ('SETTINGS = ()\nPRESETS = {"decoder_wdith": 12}', "unknown parameters; found .*decoder_wdith"),
    ],
)
def test_a_file_with_a_mistake_is_named(own: Path, source: str, complaint: str) -> None:
    own.write_text(source)
    with pytest.raises(UserError, match=complaint):
        HideScenesParameters.model_validate(SMALL)


@pytest.mark.parametrize(
    ("written", "instead", "complaint"),
    [
        ('name = "own"', 'name = "gs_hider"', "found name = 'gs_hider'; expected name = 'own'"),
        ('{**self.settings, "levels": levels}', "{**self.settings}", "found settings without levels = 1"),
        ("return Own(**settings)", "return forgetful(Own(**settings))", "found networks without message_decoder"),
        (
            "    def initial_attributes",
            "    def attribute_shapes(self):\n        return {'Features': (8,)}\n\n    def initial_attributes",
            "found the name 'Features'; expected methods and attributes named by a small letter",
        ),
        (
            "self.levels = levels",
            "self.levels = int(torch.tensor([levels]).sum())",
            "found RuntimeError: Tensor.item.. cannot be called on meta tensors; expected a method .*meta device",
        ),
    ],
)
def test_what_could_not_be_built_again_is_refused_before_it_is_trained(
    own: Path, written: str, instead: str, complaint: str
) -> None:
    forgetful = """

def forgetful(method):
    method.networks = {name: each for name, each in method.networks.items() if name == "scene_decoder"}
    return method
"""
    assert written in SOURCE
    own.write_text(SOURCE.replace(written, instead) + forgetful)
    with pytest.raises(UserError, match=complaint):
        HideScenesParameters.model_validate(SMALL).build_method(["statue"], None)


def test_a_file_whose_name_could_not_be_imported_is_refused_before_it_is_trained(own: Path) -> None:
    own.with_name("Mine.py").write_text(SOURCE.replace('name = "own"', 'name = "Mine"'))
    parameters = HideScenesParameters.model_validate({**SMALL, "method": "Mine"})
    with pytest.raises(UserError, match="Mine: a method's containers could not be imported; found the name 'Mine'"):
        parameters.build_method(["statue"], None)


def test_a_setting_that_could_not_be_imported_is_refused(own: Path) -> None:
    own.write_text(SOURCE.replace('(*COUPLED_SETTINGS, "levels")', '(*COUPLED_SETTINGS, "levels", "iterations")'))
    parameters = HideScenesParameters.model_validate({**SMALL, "iterations": 2000})
    with pytest.raises(UserError, match="found iterations = 2000; expected numbers up to 1024"):
        parameters.build_method(["statue"], None)


def test_networks_that_nobody_would_keep_are_refused(own: Path) -> None:
    own.write_text(SOURCE.replace("return Own(**settings)", "return with_table(Own(**settings))") + WITH_TABLE)
    with pytest.raises(UserError, match="found table; expected scene_decoder and message_decoder"):
        build_method("own", {**COUPLED, "levels": 1})
