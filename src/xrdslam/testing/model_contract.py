"""The contract of a map: subclass, say how it is built, and pytest runs the rest."""

from collections.abc import Callable
from typing import ClassVar

import pytest
import torch
from torch import Tensor

from xrdslam.core.algorithm import Scene
from xrdslam.core.camera import Camera
from xrdslam.core.dataset import Dataset
from xrdslam.core.errors import PluginError
from xrdslam.core.frame import Frame
from xrdslam.core.model import Model
from xrdslam.testing.bits import different_leaves, frame_images, through_a_file
from xrdslam.testing.model_checks import (
    batch_of,
    check_losses,
    check_parameter_groups,
    check_rendering,
    check_surface,
)
from xrdslam.testing.spoilt import without_depth
from xrdslam.testing.toy_sequence import toy_sequence

__all__ = ["ModelContract"]


class ModelContract:
    """What every map must keep to.

    ```python
    class TestMyMap(ModelContract):
        def make_model(self, scene: Scene, frame: Frame) -> Model:
            return MyMap(MyConfig(), scene.camera)
    ```

    Tests of what the map does not bring (`supports`) are skipped.
    """

    seed: ClassVar[int] = 0

    def make_model(self, scene: Scene, frame: Frame) -> Model:
        """Build the empty map; `frame` is the first one, its pose set."""
        raise NotImplementedError(f"{type(self).__name__} must say how its map is built: make_model(scene, frame)")

    def make_sequence(self) -> Dataset:
        """Return what the map is grown from; at least two frames with rgb, depth and pose."""
        return toy_sequence(num_frames=3)

    def test_an_empty_map_says_so(self) -> None:
        model, _ = self._empty()
        assert model.size == 0, f"a new map has size {model.size}; the first frame and lost tracking are told by 0"

    def test_extending_grows_the_map_by_what_it_lacks(self) -> None:
        model, frames = self._empty()
        first = model.extend(frames[0], _pose(frames[0]))
        assert first > 0, "the first frame added nothing"
        assert model.size == first, f"the first frame added {first}, but the map has size {model.size}"
        again = model.extend(frames[0], _pose(frames[0]))
        assert 0 <= again < first, f"the same frame again added {again}, at first {first}: it was in the map already"
        assert model.size >= first, "the map shrank"

    def test_extending_changes_neither_the_frame_nor_its_pose(self) -> None:
        model, frames = self._empty()
        images, state = frame_images(frames[0]), through_a_file(dict(frames[0].pose.state_dict()))
        model.extend(frames[0], _pose(frames[0]))
        changed = different_leaves(images, frame_images(frames[0]))
        changed += different_leaves(state, dict(frames[0].pose.state_dict()))
        assert not changed, f"extend changed {changed} of the frame"

    def test_parameter_groups_are_sound(self) -> None:
        model, _ = self._grown()
        check_parameter_groups(model)
        if model.supports("losses"):
            assert model.parameter_groups(), "a map with losses has parameters to descend: parameter_groups() is empty"

    def test_mapping_losses_reach_the_map(self) -> None:
        model, frames = self._grown()
        self._require(model, "losses")
        check_losses(model, frames[1], _pose(frames[1]), "mapping")

    def test_tracking_losses_reach_the_pose(self) -> None:
        model, frames = self._grown()
        self._require(model, "losses")
        check_losses(model, frames[1], _pose(frames[1]), "tracking")

    def test_losses_are_numbers_where_no_depth_was_measured(self) -> None:
        model, frames = self._grown()
        self._require(model, "losses")
        losses = model.losses(batch_of(model, without_depth(frames[1]), _pose(frames[1])), "mapping")
        spoilt = [name for name, loss in losses.items() if not bool(torch.isfinite(loss))]
        assert not spoilt, f"losses {spoilt} are not finite for a frame whose depth is 0 everywhere"

    def test_renders_every_size_of_image(self) -> None:
        model, frames = self._grown()
        self._require(model, "render")
        for camera in (frames[0].camera, frames[0].camera.resized(17, 13), frames[0].camera.resized(1, 1)):
            check_rendering(model, camera, _pose(frames[0]))

    def test_renders_from_where_nothing_was_mapped(self) -> None:
        model, frames = self._grown()
        self._require(model, "render")
        camera = frames[0].camera.resized(16, 12)
        behind, far = _pose(frames[0]).clone(), _pose(frames[0]).clone()
        behind[:3, :3] = behind[:3, :3] @ torch.diag(torch.tensor([-1.0, 1.0, -1.0])).to(behind)
        far[:3, 3] += 1000.0
        for T_world_camera in (behind, far):
            check_rendering(model, camera, T_world_camera)

    def test_renders_the_empty_map(self) -> None:
        model, frames = self._empty()
        self._require(model, "render")
        rendering = check_rendering(model, frames[0].camera.resized(16, 12), _pose(frames[0]))
        assert float(rendering.opacity.max()) < 0.5, "the empty map explains what is seen"

    def test_a_saved_map_comes_back_whatever_its_size(self) -> None:
        model, frames = self._grown()
        state = through_a_file(dict(model.state_dict()))
        other, _ = self._empty()
        other.load_state_dict(state)
        assert other.size == model.size, f"saved with size {model.size}, came back with {other.size}"
        changed = different_leaves(state, dict(other.state_dict()))
        assert not changed, f"{changed} did not come back from state_dict()"
        if model.supports("render"):
            camera: Camera = frames[0].camera.resized(16, 12)
            with torch.no_grad():
                images = [m.render(camera, _pose(frames[0]))._asdict() for m in (model, other)]
            changed = different_leaves(*images)
            assert not changed, f"the map that came back renders another {changed}: state_dict() lacks something"

    def test_surfaces_are_sound(self) -> None:
        model, frames = self._grown()
        check_surface(model, frames[0].camera, _pose(frames[0]))

    def test_says_what_it_cannot_do(self) -> None:
        model, frames = self._grown()
        calls: dict[str, Callable[[], object]] = {
            "losses": lambda: model.losses(batch_of(model, frames[0], _pose(frames[0])), "mapping"),
            "render": lambda: model.render(frames[0].camera, _pose(frames[0])),
            "mesh": lambda: model.mesh([]),
            "point_cloud": model.point_cloud,
        }
        for capability in (c for c in calls if not model.supports(c)):
            with pytest.raises(PluginError):
                calls[capability]()

    def _empty(self) -> tuple[Model, list[Frame]]:
        dataset = self.make_sequence()
        frames = list(dataset.frames())
        for frame in frames:
            assert frame.T_world_camera_gt is not None, "make_sequence() must bring poses"
            frame.pose.set_(frame.T_world_camera_gt)
        torch.manual_seed(self.seed)
        return self.make_model(Scene.of(dataset), frames[0]), frames

    def _grown(self) -> tuple[Model, list[Frame]]:
        model, frames = self._empty()
        for frame in frames[:2]:
            model.extend(frame, _pose(frame))
        return model, frames

    def _require(self, model: Model, capability: str) -> None:
        if not model.supports(capability):
            pytest.skip(f"{type(model).__name__} has no {capability}")


def _pose(frame: Frame) -> Tensor:
    return frame.pose.matrix().detach()
