"""The map: a set of Gaussians in world coordinates."""

from collections.abc import Sequence
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn

from xrdslam.algorithms.splatam.config import SplatamMapConfig
from xrdslam.algorithms.splatam.losses import mapping_losses, tracking_losses
from xrdslam.algorithms.splatam.seeding import Seeds, pixels_to_seed, seeds_of
from xrdslam.algorithms.splatam.surface import fuse_views, write_splats
from xrdslam.core.batch import Batch, ImageBatch, Stage
from xrdslam.core.camera import Camera
from xrdslam.core.errors import PluginError
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.core.model import Model, Rendering, View
from xrdslam.core.optimisation import GroupedOptimiser, ParameterGroup
from xrdslam.core.surface import PointCloud, TriangleMesh
from xrdslam.ops import splats

__all__ = ["GaussianMap"]

PARAMETERS = ("means", "log_scales", "opacity_logits", "colors", "quats_wxyz")


class GaussianMap(Model):
    """N Gaussians: means [m], log standard deviations [log m], opacity logits, colours; quaternions where anisotropic.

    Rows are kept in the order in which pixels seeded them, raster order within a frame, and sorted along a Morton curve
    whenever a tenth of them is new: neighbours in space are neighbours in memory, which halves the rasteriser's time.
    """

    batch_kind = "image"
    means: Float[Tensor, "n 3"]
    log_scales: Float[Tensor, "n s"]
    opacity_logits: Float[Tensor, "n 1"]
    colors: Float[Tensor, "n 3"]
    quats_wxyz: Float[Tensor, "n 4"]
    birth: Int64[Tensor, " n"]

    def __init__(self, config: SplatamMapConfig, scene_radius_m: float) -> None:
        super().__init__()
        self.config = config
        self.scene_radius_m = scene_radius_m
        sizes = {"means": 3, "log_scales": 3 if config.anisotropic else 1, "opacity_logits": 1, "colors": 3}
        sizes["quats_wxyz"] = 4
        for name in PARAMETERS:
            setattr(self, name, nn.Parameter(torch.empty(0, sizes[name])))
        self.quats_wxyz.requires_grad_(config.anisotropic)
        self.register_buffer("birth", torch.empty(0, dtype=torch.int64))
        self._num_unsorted = 0
        self._lists: tuple[Frame, splats.TileLists] | None = None

    @property
    def size(self) -> int:
        return len(self.means)

    def splat(
        self, camera: Camera, T_world_camera: Float[Tensor, "4 4"], lists: splats.TileLists | None = None
    ) -> splats.SplatRender:
        """Rasterise with gradients; depth is sum(z alpha T), not divided by the silhouette (the paper's equation 5)."""
        return splats.render(
            self.means,
            self.log_scales,
            self.opacity_logits,
            self.colors,
            se3.inverse(T_world_camera),
            camera,
            quats_wxyz=self.quats_wxyz if self.config.anisotropic else None,
            near=self.config.near_m,
            lowpass=self.config.lowpass_px2,
            lists=lists,
        )

    @torch.no_grad()
    def render(self, camera: Camera, T_world_camera: Float[Tensor, "4 4"]) -> Rendering:
        image = self.splat(camera, T_world_camera)
        return Rendering(image.rgb, image.depth, image.opacity)

    def losses(self, batch: Batch, stage: Stage) -> dict[str, Tensor]:
        if not isinstance(batch, ImageBatch):
            raise PluginError("the map of splatam takes whole images; choose a tracking method that draws images")
        if stage == "tracking":
            image = self.splat(batch.frame.camera, batch.T_world_camera, self._lists_of(batch.frame))
            return tracking_losses(image, batch.frame, self.config)
        return mapping_losses(self.splat(batch.frame.camera, batch.T_world_camera), batch.frame, self.config)

    def _lists_of(self, frame: Frame) -> splats.TileLists:
        """Return the tile lists that the tracking iterations of one frame share; each frame begins with new ones."""
        if self._lists is None or self._lists[0] is not frame:
            self._lists = (frame, splats.TileLists())
        return self._lists[1]

    def parameter_groups(self) -> list[ParameterGroup]:
        rates = {
            "means": self.config.lr_means,
            "log_scales": self.config.lr_scales,
            "opacity_logits": self.config.lr_opacities,
            "colors": self.config.lr_colors,
        }
        if self.config.anisotropic:
            rates["quats_wxyz"] = self.config.lr_quats
        return [ParameterGroup(name, [getattr(self, name)], lr, eps=self.config.adam_eps) for name, lr in rates.items()]

    @torch.no_grad()
    def extend(self, frame: Frame, T_world_camera: Float[Tensor, "4 4"]) -> int:
        """Seed a Gaussian at every measured pixel that the map does not explain (section 3.3 of the paper)."""
        assert frame.depth is not None, "an algorithm checks that its frames have depth"
        mask = frame.depth > 0 if self.size == 0 else self._unexplained(frame, T_world_camera)
        seeds = seeds_of(frame, T_world_camera, mask, self.config)
        self._append(seeds, frame.index)
        return len(seeds.means)

    def _unexplained(self, frame: Frame, T_world_camera: Tensor) -> Bool[Tensor, "h w"]:
        return pixels_to_seed(self.render(frame.camera, T_world_camera), frame, self.config)

    def _append(self, seeds: Seeds, birth: int) -> None:
        if not len(seeds.means):
            return
        for name, new in seeds._asdict().items():
            self._replace(name, torch.cat((getattr(self, name).detach(), new)))
        self.birth = torch.cat((self.birth, torch.full((len(seeds.means),), birth).to(self.birth)))
        self._num_unsorted += len(seeds.means)
        if self._num_unsorted > 0.1 * self.size and self._num_unsorted < self.size:
            self._sort()

    def _sort(self) -> None:
        order = splats.morton_order(self.means.detach())
        for name in PARAMETERS:
            self._replace(name, getattr(self, name).detach()[order])
        self.birth = self.birth[order]
        self._num_unsorted = 0

    def _replace(self, name: str, values: Tensor) -> nn.Parameter:
        old: nn.Parameter = getattr(self, name)
        new = nn.Parameter(values, requires_grad=old.requires_grad)
        setattr(self, name, new)
        return new

    @torch.no_grad()
    def prune(self, optimiser: GroupedOptimiser) -> int:
        """Remove transparent and oversized Gaussians; moments *and gradients* follow the rows that stay.

        SplaTAM rebuilds every parameter here and thereby drops the iteration's gradients, so that its pruning
        iterations never step; keeping them is one step more for the same work.
        """
        transparent = torch.sigmoid(self.opacity_logits[:, 0]) < self.config.prune_opacity
        oversized = self.log_scales.amax(1).exp() > self.config.prune_scale * self.scene_radius_m
        kept = ~(transparent | oversized)
        removed = int((~kept).sum())
        if not removed:
            return 0
        rows = kept.nonzero()[:, 0]
        for name in PARAMETERS:
            old = getattr(self, name)
            optimiser.reindex_(old, self._replace(name, old.detach()[rows]), rows)
        self.birth = self.birth[rows]
        return removed

    def mesh(self, views: Sequence[View]) -> TriangleMesh:
        """Fuse the depth that the *map* renders from where it was seen into a TSDF, and extract its zero level."""
        return fuse_views(self, views, self.config)

    def point_cloud(self) -> PointCloud:
        """Return the means."""
        return PointCloud(self.means.detach().cpu().numpy(), self.colors.detach().clamp(0, 1).cpu().numpy())

    def export(self, folder: Path) -> list[Path]:
        """Write splats.ply, the layout of 3D Gaussian splatting that common viewers open."""
        path = folder / "splats.ply"
        write_splats(path, self.means, self.log_scales, self.opacity_logits, self.colors, self.quats_wxyz)
        return [path]

    def get_extra_state(self) -> Tensor:
        """Return how many rows came since the last sorting: a resumed run sorts when this one would."""
        return torch.tensor(self._num_unsorted)

    def set_extra_state(self, state: Tensor) -> None:
        """Take over what `get_extra_state` returned."""
        self._num_unsorted = int(state)
