"""The separation penalty against its definition in plain torch, and its gradients against autograd's."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from opencl import separation
from opencl.contract import RasterSettings
from opencl.program import ProgramKey
from opencl.separation import separation_penalty
from tests.opencl.differentiated import with_gradients
from tests.opencl.runtimes import bits, printed_with_threads

WEIGHTS = 100.0, 60.0


def inputs(count: int, channels: int, pictures: int, each: int) -> tuple[Tensor, Tensor, Tensor]:
    """Features, directions and readings in float64, the first and the last with gradients.

    Shares lie on both sides of 0 and of 1, and readings on both sides of half a share.
    """
    generator = torch.Generator().manual_seed(count + channels + pictures + each)
    shapes = (count, channels), (pictures, channels), (pictures, each, channels)
    features, directions, readings = (torch.randn(*shape, dtype=torch.float64, generator=generator) for shape in shapes)
    return (3 * features).requires_grad_(), directions, readings.requires_grad_()


def penalty(features: Tensor, directions: Tensor, readings: Tensor) -> Tensor:
    return separation_penalty(features, directions, readings, *WEIGHTS)


def expected(features: Tensor, directions: Tensor, readings: Tensor) -> Tensor:
    centred = features.sigmoid() - 0.5
    shares = (centred @ directions.T + 0.5).clamp(0, 1)
    common = (shares.sum(dim=1).square() - shares.square().sum(dim=1)) / 2
    held = torch.einsum("nm,prm->npr", centred, readings).abs()
    beyond = (held - shares.detach()[..., None] / 2).clamp_min(0).mean(dim=(0, 2)).sum()
    return WEIGHTS[0] * common.mean() + WEIGHTS[1] * beyond


def check(leaves: tuple[Tensor, Tensor, Tensor], tolerance: float = 1e-11) -> None:
    features, _, readings = leaves
    found = with_gradients(penalty(*leaves), [features, readings])
    for one, other in zip(found, with_gradients(expected(*leaves), [features, readings]), strict=True):
        torch.testing.assert_close(one, other, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("count", [1, 31, 32, 33, 700])
@pytest.mark.parametrize("sizes", [(16, 2, 7), (3, 1, 1), (20, 5, 7), (33, 18, 3)], ids=str)
def test_it_is_its_definition(count: int, sizes: tuple[int, int, int]) -> None:
    check(inputs(count, *sizes))


@given(count=st.integers(1, 90), channels=st.integers(1, 40), pictures=st.integers(1, 20), each=st.integers(1, 9))
def test_of_any_size(count: int, channels: int, pictures: int, each: int) -> None:
    check(inputs(count, channels, pictures, each))


@pytest.mark.parametrize("feature", [0.0, -0.0, 1e-12, 40.0, -800.0, torch.inf, -torch.inf])
def test_features_however_far(feature: float) -> None:
    _, directions, readings = inputs(40, 16, 2, 7)
    check((torch.full((40, 16), feature, dtype=torch.float64).requires_grad_(), directions, readings))


def test_where_a_share_ends_and_a_reading_is_just_fair() -> None:
    """At a share of exactly 0 or 1, and at a reading of exactly half a share, gradients are torch's."""
    directions, readings = torch.eye(4, dtype=torch.float64)[:2], torch.eye(4, dtype=torch.float64)[2:].view(2, 1, 4)
    centred = torch.tensor([[-0.5, 0.5, 0.0, 0.5], [0.5, 0.5, -0.5, 0.5], [0.0, 0.0, 0.25, -0.25]], dtype=torch.float64)
    features = (centred + 0.5).logit().requires_grad_()
    check((features, directions, readings.clone().requires_grad_()))


def test_gradients_against_finite_differences() -> None:
    """Each term by itself: the second treats shares as constants, which finite differences of features would not."""
    features, directions, readings = inputs(3, 4, 2, 2)

    def common(features: Tensor) -> Tensor:
        return separation_penalty(features, directions, readings, WEIGHTS[0], 0.0)

    def beyond(readings: Tensor) -> Tensor:
        return separation_penalty(features, directions, readings, 0.0, WEIGHTS[1])

    assert torch.autograd.gradcheck(common, features)
    assert torch.autograd.gradcheck(beyond, readings)


def clear_of_thresholds(features: Tensor, directions: Tensor, readings: Tensor) -> Tensor:
    """The features whose shares and readings are too far from the ends of gradients for rounding to cross them."""
    centred = features.detach().sigmoid() - 0.5
    shares = centred @ directions.T + 0.5
    held = torch.einsum("nm,prm->npr", centred, readings.detach()).abs()
    over = held - shares.clamp(0, 1)[..., None] / 2
    nearest = torch.cat([shares, shares - 1, over.flatten(1), held.flatten(1)], dim=1).abs().min(dim=1).values
    return features.detach()[nearest > 1e-5].requires_grad_()


def test_float32_rounds_little() -> None:
    features, directions, readings = inputs(60_000, 16, 2, 7)
    features = clear_of_thresholds(features, directions, readings)
    assert len(features) > 50_000
    single = (
        features.detach().float().requires_grad_(),
        directions.float(),
        readings.detach().float().requires_grad_(),
    )
    found = with_gradients(penalty(*single), [single[0], single[2]])
    exact = with_gradients(expected(features, directions, readings), [features, readings])
    for one, other in zip(found, exact, strict=True):
        assert one.dtype == torch.float32
        assert float((one - other).norm() / other.norm()) < 2e-6


def test_a_processor_with_narrow_registers_computes_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    features, directions, readings = inputs(70, 20, 3, 7)
    usual = with_gradients(penalty(features, directions, readings), [features, readings])
    narrow = ProgramKey("separation", "cpu", torch.float64, RasterSettings())
    monkeypatch.setattr(separation, "product_program", lambda *_: narrow)
    again = with_gradients(penalty(features, directions, readings), [features, readings])
    for one, other in zip(again, usual, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-12, atol=1e-12)


def test_only_what_is_asked_for_has_a_gradient() -> None:
    features, directions, readings = inputs(70, 16, 2, 7)
    value, *both = with_gradients(penalty(features, directions, readings), [features, readings])
    (of_features,) = with_gradients(penalty(features, directions, readings.detach()), [features])[1:]
    (of_readings,) = with_gradients(penalty(features.detach(), directions, readings), [readings])[1:]
    assert bits(of_features) == bits(both[0])
    assert bits(of_readings) == bits(both[1])
    with torch.no_grad():
        assert bits(penalty(features, directions, readings)) == bits(value)


def test_what_lies_otherwise_in_memory() -> None:
    features, directions, readings = inputs(70, 16, 2, 7)
    across = features.detach().T.contiguous().T
    negated = torch._neg_view(-features.detach())
    for other in (across, negated):
        assert bits(penalty(other, directions, readings)) == bits(penalty(features, directions, readings))


def test_what_is_not_a_number_stays_one() -> None:
    features, directions, readings = inputs(70, 16, 2, 7)
    broken = features.detach().clone()
    broken[33, 2] = torch.nan
    assert penalty(broken, directions, readings).isnan()


BITS = """
import torch
from tests.opencl.differentiated import with_gradients
from tests.opencl.test_separation import inputs, penalty
features, directions, readings = (tensor.detach().float() for tensor in inputs(3000, 16, 2, 7))
leaves = [features.requires_grad_(), readings.requires_grad_()]
found = with_gradients(penalty(features, directions, readings), leaves)
print([hash(tensor.contiguous().numpy().tobytes()) for tensor in found])
"""


def test_the_same_bits_with_any_number_of_threads() -> None:
    assert printed_with_threads(BITS, 1) == printed_with_threads(BITS, 2)


def test_autocast_changes_nothing() -> None:
    features, directions, readings = (tensor.detach().float() for tensor in inputs(40, 16, 2, 7))
    leaves = [features.requires_grad_(), readings.requires_grad_()]
    expected = with_gradients(penalty(features, directions, readings), leaves)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        found = with_gradients(penalty(features, directions, readings), leaves)
    assert [*map(bits, found)] == [*map(bits, expected)]


@pytest.mark.usefixtures("any_arrays")
def test_what_does_not_fit_is_refused() -> None:
    features, directions, readings = inputs(4, 16, 2, 7)
    for wrong in (
        (features[:0], directions, readings),
        (features[:, :9], directions, readings),
        (features, directions[:1], readings),
        (features, directions, readings[:, :0]),
        (features, directions, readings[0]),
    ):
        with pytest.raises(ValueError, match=r"expected \[N,M\], \[P,M\] and \[P,R,M\]"):
            penalty(*wrong)
    with pytest.raises(ValueError, match="expected float32 or float64 of a CPU"):
        penalty(features.float(), directions, readings)
    with pytest.raises(ValueError, match="directions that ask for a gradient"):
        penalty(features, directions.clone().requires_grad_(), readings)
