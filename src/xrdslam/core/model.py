"""The map of a method."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.modules.module import _IncompatibleKeys

from xrdslam.core.batch import Batch, BatchKind, Stage
from xrdslam.core.camera import Camera
from xrdslam.core.errors import PluginError
from xrdslam.core.frame import Frame
from xrdslam.core.optimisation import ParameterGroup
from xrdslam.core.surface import PointCloud, TriangleMesh

__all__ = ["Model", "Rendering", "View"]


class Rendering(NamedTuple):
    """What a map looks like from a pose."""

    rgb: Float[Tensor, "h w 3"]
    """Colour, nominally in [0, 1], not clamped."""
    depth: Float[Tensor, "h w"]
    """Depth along z [m], 0 where nothing is seen."""
    opacity: Float[Tensor, "h w"]
    """How much of the pixel the map explains, in [0, 1]."""


class View(NamedTuple):
    """From where a scene was seen."""

    camera: Camera
    T_world_camera: Float[Tensor, "4 4"]


class Model(nn.Module, ABC):
    """A map: parameters, how they are seen, how they grow.

    `extend` and `size` are all that every map has; the rest is what a map *can* do: `supports("render")` says whether a
    class brings it, and callers ask before they call. `batch_kind` names the batches that `losses` takes, so that a
    tracker of one method can follow the map of another that takes the same kind.
    """

    batch_kind: ClassVar[BatchKind] = "image"

    @abstractmethod
    def extend(self, frame: Frame, T_world_camera: Float[Tensor, "4 4"]) -> int:
        """Grow the map by what `frame`, seen from this pose, shows and the map lacks; return how much was added."""

    @property
    @abstractmethod
    def size(self) -> int:
        """How many primitives (Gaussians, voxels, points, grid vertices) the map holds."""

    def parameter_groups(self) -> list[ParameterGroup]:
        """Return what an optimiser of the map moves, with learning rates."""
        return []

    def losses(self, batch: Batch, stage: Stage) -> dict[str, Tensor]:
        """Return named scalar losses, weighted, of the map against what was measured."""
        raise self._cannot("losses")

    def render(self, camera: Camera, T_world_camera: Float[Tensor, "4 4"]) -> Rendering:
        """Return what a camera sees; no measured depth helps."""
        raise self._cannot("render")

    def mesh(self, views: Sequence[View]) -> TriangleMesh:
        """Return the surface of the map; `views` say from where the scene was seen."""
        raise self._cannot("mesh")

    def point_cloud(self) -> PointCloud:
        """Return the map as points."""
        raise self._cannot("point_cloud")

    def export(self, folder: Path) -> list[Path]:
        """Write the method's own file formats (3DGS splats, a voxel file) into `folder`; return what was written."""
        return []

    def load_state_dict(
        self, state_dict: Mapping[str, Any], strict: bool = True, assign: bool = False
    ) -> _IncompatibleKeys:
        """Take over a saved map into an empty one: parameters and buffers get the number of rows that they have there.

        Only the first dimension may differ; a map that grows in another one sets its sizes before it calls this. State
        beside tensors that are registered goes through `get_extra_state` and `set_extra_state`, as a tensor.
        """
        for prefix, module in self.named_modules():
            _take_rows(module, f"{prefix}." if prefix else "", state_dict)
        found: _IncompatibleKeys = super().load_state_dict(state_dict, strict, assign)
        return found

    @classmethod
    def supports(cls, capability: str) -> bool:
        """Say whether this class brings its own `losses`, `render`, `mesh` or `point_cloud`."""
        return getattr(cls, capability) is not getattr(Model, capability)

    def _cannot(self, capability: str) -> PluginError:
        return PluginError(f"the map {type(self).__name__} has no {capability!r}; choose a method that does without")


def _take_rows(module: nn.Module, prefix: str, state: Mapping[str, Any]) -> None:
    """Give a module's own parameters and buffers as many rows as the state has for them."""
    for name, held in [*module.named_parameters(recurse=False), *module.named_buffers(recurse=False)]:
        saved = state.get(prefix + name)
        if not isinstance(saved, Tensor) or saved.ndim != held.ndim or saved.shape == held.shape:
            continue
        if saved.shape[1:] == held.shape[1:]:
            rows = held.new_empty(saved.shape)
            setattr(module, name, nn.Parameter(rows, held.requires_grad) if isinstance(held, nn.Parameter) else rows)
