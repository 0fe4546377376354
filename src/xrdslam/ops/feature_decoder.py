"""A small network that turns a point and its interpolated features into occupancy or colour.

The decoder of NICE-SLAM and Point-SLAM (after Convolutional Occupancy Networks): five ReLU layers of 32 units on a sine
embedding of the point, the features added after each, the embedding once more before the fourth.
"""

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from xrdslam.core.errors import ConfigError

__all__ = ["FeatureDecoder", "decode_features", "decode_features_torch"]

EMBEDDED, HIDDEN, LAYERS, SKIP = 93, 32, 5, 3
_PADDED = 96


class FeatureDecoder(nn.Module):
    """The parameters, under the names that published checkpoints have.

    The embedding's matrix begins as N(0, 25^2) [rad/m]; the layers as Xavier-uniform, the output without its gain.
    """

    def __init__(self, channels: int, outputs: int, generator: torch.Generator | None = None) -> None:
        """Build a decoder of `channels` features a point, a multiple of 16 up to 64, and up to 8 `outputs`."""
        super().__init__()
        if channels not in (16, 32, 48, 64) or not 1 <= outputs <= 8:
            raise ConfigError(
                f"feature decoder of {channels} features and {outputs} outputs: "
                "features must be 16, 32, 48 or 64, outputs 1 to 8"
            )
        self.embedder = nn.Module()
        self.embedder.register_parameter("_B", nn.Parameter(25 * torch.randn(3, EMBEDDED, generator=generator)))
        widths = [EMBEDDED, HIDDEN, HIDDEN, EMBEDDED + HIDDEN, HIDDEN]
        self.pts_linears = nn.ModuleList(nn.Linear(width, HIDDEN) for width in widths)
        self.fc_c = nn.ModuleList(nn.Linear(channels, HIDDEN) for _ in widths)
        self.output_linear = nn.Linear(HIDDEN, outputs)
        self._begin(generator)
        self._packed: tuple[tuple[int, ...], tuple[Tensor, Tensor]] | None = None

    @torch.no_grad()
    def _begin(self, generator: torch.Generator | None) -> None:
        for layer in (*self.pts_linears, *self.fc_c, self.output_linear):
            assert isinstance(layer, nn.Linear)
            bound = (6 / (layer.in_features + layer.out_features)) ** 0.5
            if layer is not self.output_linear:
                bound *= 2**0.5
            layer.weight.copy_((torch.rand(layer.weight.shape, generator=generator) * 2 - 1) * bound)
            layer.bias.zero_()

    def weights(self) -> tuple[Tensor, ...]:
        """Return all parameters in the order of `decode_features`."""
        layers = [t for layer in (*self.pts_linears, *self.fc_c) for t in (layer.weight, layer.bias)]
        return (self.embedder._B, *layers, self.output_linear.weight, self.output_linear.bias)

    def packs(self) -> tuple[Tensor, Tensor]:
        """Return the weights as the CPU kernel reads them; they are kept while nobody optimises the weights.

        A fused optimiser does not count up the version of what it changes, so that while weights want gradients nothing
        is kept.
        """
        weights = self.weights()
        if any(w.requires_grad for w in weights):
            self._packed = None
            return _forward_pack(weights), _backward_pack(weights)
        state = tuple(v for w in weights for v in (w.data_ptr(), w._version))
        if self._packed is None or self._packed[0] != state:
            self._packed = (state, (_forward_pack(weights), _backward_pack(weights)))
        return self._packed[1]

    def forward(self, points: Float[Tensor, "n 3"], features: Float[Tensor, "n c"]) -> Float[Tensor, "n outputs"]:
        packs = self.packs() if points.device.type == "cpu" and points.dtype == torch.float32 else None
        return decode_features(points, features, self.weights(), packs)


def decode_features(
    points: Float[Tensor, "n 3"],
    features: Float[Tensor, "n c"],
    weights: Sequence[Tensor],
    packs: tuple[Tensor, Tensor] | None = None,
) -> Float[Tensor, "n outputs"]:
    """Return the outputs of a decoder at points [m].

    e = sin(p B); h = relu(W_i h + b_i) + V_i c + d_i for i = 0..4 from h = e, with [e, h] in place of h before i = 3;
    out = W h + b. `weights` are B, W_0, b_0, ..., W_4, b_4, V_0, d_0, ..., V_4, d_4, W, b; `packs` are the same as the
    CPU kernel reads them (`FeatureDecoder.packs`). Differentiable in points, features and weights; points whose
    cotangent is zero cost nothing.
    """
    tensors = (points, features, *weights)
    if all(t.device.type == "cpu" and t.dtype == torch.float32 for t in tensors):
        made = packs or (_forward_pack(weights), _backward_pack(weights))
        return _DecodeFeatures.apply(*tensors, *made)  # type: ignore[no-any-return, no-untyped-call]  # torch
    return decode_features_torch(points, features, weights)


def decode_features_torch(points: Tensor, features: Tensor, weights: Sequence[Tensor]) -> Float[Tensor, "n outputs"]:
    """Return the outputs of a decoder: the twin of the kernel."""
    embedded = (points @ weights[0]).sin()
    hidden = embedded
    for layer in range(LAYERS):
        if layer == SKIP:
            hidden = torch.cat((embedded, hidden), 1)
        W, b, V, d = (weights[1 + 2 * layer + i] for i in (0, 1, 2 * LAYERS, 2 * LAYERS + 1))
        hidden = torch.addmm(b, hidden, W.mT).relu() + torch.addmm(d, features, V.mT)
    return torch.addmm(weights[-1], hidden, weights[-2].mT)


def _split(weights: Sequence[Tensor]) -> tuple[list[Tensor], list[Tensor], list[Tensor], list[Tensor]]:
    """Return W, b, V, d, with W_3 as two: for the embedding and for the hidden units."""
    W, b = list(weights[1:11:2]), list(weights[2:11:2])
    W[SKIP : SKIP + 1] = [W[SKIP][:, :EMBEDDED], W[SKIP][:, EMBEDDED:]]
    return W, b, list(weights[11:21:2]), list(weights[12:21:2])


@torch.no_grad()
def _forward_pack(weights: Sequence[Tensor]) -> Tensor:
    """Lay the weights out for the forward kernel (its file says how)."""
    W, b, V, d = _split(weights)
    pad = nn.functional.pad
    layers = [pad(w.mT, (0, 0, 0, _PADDED - EMBEDDED if w.shape[1] == EMBEDDED else 0)) for w in W]
    outputs = HIDDEN - len(weights[-1])
    parts = [pad(weights[0], (0, _PADDED - EMBEDDED)), *layers, *b, *d, *(v.mT for v in V)]
    parts += [pad(weights[-2].mT, (0, outputs)), pad(weights[-1], (0, outputs))]
    return torch.cat([part.reshape(-1) for part in parts])


@torch.no_grad()
def _backward_pack(weights: Sequence[Tensor]) -> Tensor:
    """Lay the weights out for the backward kernel."""
    W, _, V, _ = _split(weights)
    pad = nn.functional.pad
    layers = [pad(w, (0, _PADDED - EMBEDDED if w.shape[1] == EMBEDDED else 0)) for w in W]
    return torch.cat([part.reshape(-1) for part in (*layers, *V, pad(weights[-2], (0, 0, 0, 8 - len(weights[-1]))))])


def _unpacked(grown: Tensor, channels: int, outputs: int) -> list[Tensor]:
    """Return the gradients of B, W, b, V, d, ... from one that lies as the forward pack does."""
    sizes = [3 * _PADDED, _PADDED * 32, 1024, 1024, _PADDED * 32, 1024, 1024, 160, 160]
    sizes += [channels * 32] * 5 + [1024, 32]
    parts = list(torch.split(grown, sizes))
    e, h = parts[4].reshape(_PADDED, 32)[:EMBEDDED], parts[5].reshape(32, 32)
    W = [parts[1].reshape(_PADDED, 32)[:EMBEDDED], parts[2].reshape(32, 32), parts[3].reshape(32, 32)]
    W += [torch.cat((e, h)), parts[6].reshape(32, 32)]
    b, d = parts[7].reshape(5, 32), parts[8].reshape(5, 32)
    layers = [t for i in range(LAYERS) for t in (W[i].mT, b[i])]
    features = [t for i in range(LAYERS) for t in (parts[9 + i].reshape(channels, 32).mT, d[i])]
    embedding = parts[0].reshape(3, _PADDED)[:, :EMBEDDED]
    return [embedding, *layers, *features, parts[14].reshape(32, 32)[:, :outputs].mT, parts[15][:outputs]]


class _DecodeFeatures(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, points: Tensor, features: Tensor, *rest: Tensor) -> Tensor:  # noqa: ANN401
        from xrdslam.ops.feature_decoder_kernels import decode
        from xrdslam.ops.threads import kernel_threads

        *weights, forward_pack, backward_pack = rest
        points, features = points.contiguous(), features.contiguous()
        count, outputs = len(points), len(weights[-1])
        kept = torch.empty((count + 31) // 32, LAYERS, 32, dtype=torch.int32)
        out = torch.empty(count, outputs)
        with kernel_threads():
            tables = (points.numpy(), features.numpy(), 0, features.shape[1], forward_pack.numpy())
            decode(*tables, outputs, kept.numpy(), out.numpy())
        ctx.save_for_backward(points, features, forward_pack, backward_pack, kept)
        ctx.outputs = outputs
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        from xrdslam.ops.feature_decoder_kernels import CHUNK, decode_backward
        from xrdslam.ops.threads import kernel_threads

        points, features, forward_pack, backward_pack, kept = ctx.saved_tensors
        channels = features.shape[1]
        needs_points, needs_features, needs_weights = ctx.needs_input_grad[:3]
        order = (cotangent != 0).any(1).nonzero()[:, 0]
        d_points = torch.zeros_like(points) if needs_points else torch.empty(0, 3)
        d_features = torch.zeros_like(features) if needs_features else torch.empty(0, channels)
        chunks = (len(order) + CHUNK - 1) // CHUNK
        grown = torch.zeros(chunks if needs_weights else 0, len(forward_pack))
        given = (points, features)
        with kernel_threads():
            decode_backward(
                *(t.numpy() for t in given),
                0,
                channels,
                *(t.numpy() for t in (forward_pack, backward_pack, kept, order, cotangent.contiguous())),
                *(t.numpy() for t in (d_points, d_features, grown)),
            )
        d_weights = _unpacked(grown.sum(0), channels, ctx.outputs) if needs_weights else [None] * 23
        return (
            d_points if needs_points else None,
            d_features if needs_features else None,
            *d_weights,
            None,
            None,
        )
