"""Learned perceptual image patch similarity (Zhang et al., CVPR 2018), version 0.1, in plain torch.

Both images go through a classification network; at several layers the channels of each pixel are scaled to unit
length, squared differences weighted by a learned number a channel, averaged over pixels, summed over layers (eq. 1).
The two backbones are two measures with values of their own: LPIPS (alex) and LPIPS (squeeze) never share a name.
"""

from collections.abc import Iterator, Mapping

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from xrdslam.evaluation.errors import EvaluationError

__all__ = ["BACKBONES", "Lpips", "Weights"]

Weights = Mapping[str, Tensor]
Image = Float[Tensor, "h w 3"]
Features = Float[Tensor, "n c h w"]
Convolved = Float[Tensor, "n d y x"]

BACKBONES = ("alex", "squeeze")
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)  # of images in [-1, 1], as the networks were trained
EPSILON = 1e-10
LAYERS = {"alex": 5, "squeeze": 7}
_ALEX = ((0, 4, 2), (3, 1, 2), (6, 1, 1), (8, 1, 1), (10, 1, 1))  # convolutions: place, stride, padding
_FIRES = ((3, 4), (6, 7), (9,), (10,), (11,), (12,))  # fire modules of SqueezeNet 1.1 up to each compared layer
_POOLED_BEFORE = 3  # the first three of these groups begin with a pooling
_MIN_SIDE = {"alex": 31, "squeeze": 17}
"""The smallest image that leaves every layer a pixel (worked out from strides and windows, held by a test)."""


class Lpips:
    """One backbone with its weights, loaded once and used for every image of a run."""

    def __init__(self, backbone: str, weights: Weights) -> None:
        """Take `features.<layer>.*` of the backbone and the heads `lin<k>`, as many as it has layers."""
        if backbone not in BACKBONES:
            raise EvaluationError(f"LPIPS with backbone {backbone!r}: there is {', '.join(BACKBONES)}")
        missing = sorted({f"lin{k}" for k in range(LAYERS[backbone])} - weights.keys())
        if missing or not any(name.startswith("features.") for name in weights):
            raise EvaluationError(f"the LPIPS weights of {backbone} lack {', '.join(missing) or 'features.*'}")
        self.backbone = backbone
        self.weights = {name: value.detach().float() for name, value in weights.items()}
        least = _MIN_SIDE[backbone]
        try:
            self(torch.zeros(least, least, 3), torch.ones(least, least, 3))
        except (KeyError, RuntimeError) as error:  # a layer that lacks, or of another shape
            raise EvaluationError(f"the LPIPS weights are not those of {backbone}: {error}") from error

    @torch.no_grad()
    def __call__(self, x: Image, y: Image) -> Float[Tensor, ""]:
        """Return the distance of two images in [0, 1]; 0 for equal ones."""
        least = _MIN_SIDE[self.backbone]
        if min(x.shape[:2]) < least:
            raise EvaluationError(
                f"LPIPS ({self.backbone}) needs images of at least {least} px, found {tuple(x.shape[:2])}"
            )
        pair = torch.stack((x, y)).float().permute(0, 3, 1, 2)
        shift, scale = (pair.new_tensor(values)[:, None, None] for values in (SHIFT, SCALE))
        pair = (2 * pair - 1 - shift) / scale
        total = pair.new_zeros(())
        for layer, features in enumerate(self._features(pair)):
            unit = features / (features.square().sum(1, keepdim=True).sqrt() + EPSILON)
            difference_sq = (unit[0] - unit[1]).square().mean((1, 2))
            total = total + (difference_sq * self._of(f"lin{layer}", pair)).sum()
        return total

    def _features(self, images: Features) -> Iterator[Features]:
        return self._alex(images) if self.backbone == "alex" else self._squeeze(images)

    def _alex(self, x: Features) -> Iterator[Features]:
        """Yield the output of each of AlexNet's five convolutions (Krizhevsky 2014), rectified."""
        for layer, (place, stride, padding) in enumerate(_ALEX):
            if layer in (1, 2):
                x = functional.max_pool2d(x, 3, 2)
            x = self._convolved(x, f"features.{place}", stride, padding)
            yield x

    def _squeeze(self, x: Features) -> Iterator[Features]:
        """Yield SqueezeNet 1.1's first convolution and the fire modules before each pooling and after the last."""
        x = self._convolved(x, "features.0", stride=2)
        yield x
        for group, fires in enumerate(_FIRES):
            if group < _POOLED_BEFORE:
                x = functional.max_pool2d(x, 3, 2, ceil_mode=True)
            for place in fires:
                x = self._convolved(x, f"features.{place}.squeeze")
                wide = self._convolved(x, f"features.{place}.expand3x3", padding=1)
                x = torch.cat((self._convolved(x, f"features.{place}.expand1x1"), wide), 1)
            yield x

    def _convolved(self, x: Features, name: str, stride: int = 1, padding: int = 0) -> Convolved:
        weight, bias = self._of(f"{name}.weight", x), self._of(f"{name}.bias", x)
        return functional.conv2d(x, weight, bias, stride, padding).relu()

    def _of(self, name: str, like: Tensor) -> Tensor:
        """Return a weight on the images' device; it moves there once."""
        if self.weights[name].device != like.device:
            self.weights[name] = self.weights[name].to(like.device)
        return self.weights[name]
