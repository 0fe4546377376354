"""Feature decoders: the kernel against its twin, the published shapes, the order of the skip, the packs."""

import pytest
import torch
from torch import Tensor

from xrdslam.core.errors import ConfigError
from xrdslam.ops.feature_decoder import FeatureDecoder, decode_features, decode_features_torch
from xrdslam.testing import KernelContract


class TestDecodeFeatures(KernelContract):
    """Two features' widths would only repeat the loops: this is the wider one, with four outputs."""

    is_smooth = False  # ReLUs
    rtol = 2e-4  # float32 arguments of up to 150 rad are off by 1e-5; seen: 4e-6
    seeds = (0,)

    def kernel(self, points: Tensor, features: Tensor, *weights: Tensor) -> Tensor:
        return decode_features(points, features, weights)

    def twin(self, points: Tensor, features: Tensor, *weights: Tensor) -> Tensor:
        return decode_features_torch(points, features, weights)

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, ...]:
        decoder = FeatureDecoder(64, 4, generator)
        weights = [w.detach() + 0.1 * torch.randn(w.shape, generator=generator) for w in decoder.weights()]
        points = torch.rand(1101, 3, generator=generator) * 4 - 2  # more than two chunks, and a part of a tile
        features = torch.randn(1101, 64, generator=generator)
        return tuple(t.to(dtype).requires_grad_() for t in (points, features, *weights))

    def empty_inputs(self) -> tuple[Tensor, ...]:
        weights = FeatureDecoder(64, 4, torch.Generator().manual_seed(0)).weights()
        return (torch.zeros(0, 3), torch.zeros(0, 64), *(w.detach() for w in weights))


@pytest.mark.parametrize(("channels", "outputs", "numbers"), [(32, 1, 15_800), (64, 1, 20_920), (32, 4, 15_899)])
def test_published_decoders_have_the_published_number_of_parameters(channels: int, outputs: int, numbers: int) -> None:
    assert sum(p.numel() for p in FeatureDecoder(channels, outputs).parameters()) == numbers


def test_the_embedding_comes_first_where_it_is_joined() -> None:
    """Without features and with the columns of the hidden units set to zero, the first three layers are cut off."""
    decoder = FeatureDecoder(32, 1, torch.Generator().manual_seed(0))
    points = torch.rand(40, 3, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        for layer in decoder.fc_c:
            layer.weight.zero_()
        decoder.pts_linears[3].weight[:, 93:].zero_()
        before = decoder(points, torch.zeros(40, 32))
        for layer in decoder.pts_linears[:3]:
            layer.weight.normal_()
        after = decoder(points, torch.zeros(40, 32))
    torch.testing.assert_close(before, after, rtol=0, atol=0)
    assert float(before.std()) > 0


def test_points_whose_cotangent_is_zero_get_no_gradient_and_the_others_the_same() -> None:
    generator = torch.Generator().manual_seed(0)
    decoder = FeatureDecoder(32, 1, generator).requires_grad_(False)
    features = torch.randn(200, 32, generator=generator).requires_grad_()
    points = torch.rand(200, 3, generator=generator)
    cotangent = torch.randn(200, 1, generator=generator)
    (whole,) = torch.autograd.grad(decoder(points, features), features, cotangent)
    cotangent[::3] = 0
    (some,) = torch.autograd.grad(decoder(points, features), features, cotangent)
    assert torch.equal(some[::3], torch.zeros_like(some[::3]))
    torch.testing.assert_close(some[1::3], whole[1::3])


def test_what_a_fused_optimiser_changed_is_seen_once_the_weights_are_frozen() -> None:
    """It does not count up the version of what it changes."""
    generator = torch.Generator().manual_seed(0)
    decoder, points, features = (
        FeatureDecoder(32, 1, generator),
        torch.rand(5, 3, generator=generator),
        torch.zeros(5, 32),
    )
    decoder.requires_grad_(False)(points, features)
    decoder.requires_grad_(True)(points, features).sum().backward()
    torch.optim.Adam(decoder.parameters(), 0.1, fused=True).step()
    decoder.requires_grad_(False)
    torch.testing.assert_close(
        decoder(points, features), decode_features_torch(points, features, decoder.weights()), rtol=1e-4, atol=1e-4
    )


@pytest.mark.parametrize(("channels", "outputs"), [(20, 1), (32, 9)])
def test_sizes_that_the_kernel_cannot_take_are_refused(channels: int, outputs: int) -> None:
    with pytest.raises(ConfigError, match="feature decoder"):
        FeatureDecoder(channels, outputs)
