"""The contract of a dataset: subclass, say how it is opened, and pytest runs the rest."""

import itertools
import pickle
from typing import ClassVar

import pytest
import torch
from torch import Tensor

from xrdslam.core.dataset import Dataset
from xrdslam.core.errors import DataError
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.testing.bits import different_leaves, frame_images

__all__ = ["DatasetContract"]


class DatasetContract:
    """What every dataset must keep to; give it a short one.

    ```python
    class TestMyFormat(DatasetContract):
        def make_dataset(self) -> Dataset:
            return MyFormat(folder_with_five_frames)

        def make_damaged(self) -> tuple[Dataset, int]:  # optional
            return MyFormat(folder_with_a_truncated_image), 2
    ```
    """

    max_depth: ClassVar[float] = 100.0
    """No measured depth is farther [m]; one that is was read in another unit."""
    consistency: ClassVar[float] = 0.05
    """The median relative difference between a frame's points, moved by the poses, and another frame's depth."""

    def make_dataset(self) -> Dataset:
        """Open the dataset."""
        raise NotImplementedError(f"{type(self).__name__} must say how its dataset is opened: make_dataset()")

    def make_damaged(self) -> tuple[Dataset, int] | None:
        """Open a dataset of which the frame of that index cannot be read."""
        return None

    def test_passes_its_own_check(self) -> None:
        dataset = self.make_dataset()
        dataset.check()
        assert len(dataset) > 0
        family, _, scene = dataset.name.partition("/")
        assert family, f"name {dataset.name!r} is not <family>/<scene>"
        assert scene, f"name {dataset.name!r} is not <family>/<scene>"

    def test_indexing_equals_iteration(self) -> None:
        dataset = self.make_dataset()
        iterated = list(dataset.frames())
        assert len(iterated) == len(dataset), f"{len(iterated)} frames were read, len() says {len(dataset)}"
        for position, frame in enumerate(iterated):
            again = dataset[position]
            assert frame.index == position, f"frame {position} says it is {frame.index}"
            assert again.index == position
            assert again.timestamp_ns == frame.timestamp_ns
            changed = different_leaves(frame_images(frame), frame_images(again))
            assert not changed, f"frame {position} read twice differs in {changed}"

    def test_an_index_behind_the_end_is_an_index_error(self) -> None:
        dataset = self.make_dataset()
        with pytest.raises(IndexError):
            dataset[len(dataset)]

    def test_images_have_the_agreed_form(self) -> None:
        dataset = self.make_dataset()
        size = (dataset.camera.height, dataset.camera.width)
        for frame in dataset.frames():
            assert frame.camera == dataset.camera, f"frame {frame.index} has another camera than the dataset"
            assert frame.rgb.dtype == torch.float32, f"rgb of {frame.rgb.dtype}"
            assert tuple(frame.rgb.shape) == (*size, 3)
            assert bool(torch.isfinite(frame.rgb).all()), f"frame {frame.index}: rgb is not finite"
            assert 0 <= float(frame.rgb.min()) <= float(frame.rgb.max()) <= 1, f"frame {frame.index}: rgb not in [0, 1]"
            assert float(frame.rgb.max()) > 2 / 255, f"frame {frame.index} is black: was it divided by 255 twice?"

    def test_depth_is_in_metres(self) -> None:
        dataset = self.make_dataset()
        for frame in dataset.frames():
            if frame.depth is None:
                continue
            depth = frame.depth
            assert depth.dtype == torch.float32, f"depth of {depth.dtype}"
            assert tuple(depth.shape) == (dataset.camera.height, dataset.camera.width)
            assert bool(torch.isfinite(depth).all()), f"frame {frame.index}: depth is not finite; 0 says no measurement"
            assert float(depth.min()) >= 0, f"frame {frame.index}: depth goes down to {float(depth.min())} m"
            assert float(depth.max()) <= self.max_depth, f"frame {frame.index}: depth reaches {float(depth.max())} m"

    def test_carries_what_it_says(self) -> None:
        dataset = self.make_dataset()
        for frame in dataset.frames():
            carried: dict[str, object] = {"rgb": frame.rgb, "depth": frame.depth, "pose": frame.T_world_camera_gt}
            carried |= {"imu": frame.imu, "stereo": frame.stereo}
            lacking = sorted(m for m in dataset.modalities if carried[m] is None)
            assert not lacking, f"frame {frame.index} lacks {lacking}, which modalities promise"

    def test_poses_are_rigid(self) -> None:
        for frame in self.make_dataset().frames():
            pose = frame.T_world_camera_gt
            if pose is not None and not bool(pose.isnan().all()):  # an unknown pose is all NaN
                assert se3.is_rigid(pose), f"frame {frame.index}: not a rigid motion: {pose.tolist()}"

    def test_time_goes_forward(self) -> None:
        stamps = [frame.timestamp_ns for frame in self.make_dataset().frames()]
        assert all(type(stamp) is int for stamp in stamps), "timestamps are int nanoseconds"
        backward = [i for i, (a, b) in enumerate(itertools.pairwise(stamps)) if b <= a]
        assert not backward, f"time does not go forward after frames {backward}"

    def test_depth_and_poses_agree(self) -> None:
        """Points of one frame, moved by the poses, land on another's depth: axes, units and inverses are right."""
        dataset = self.make_dataset()
        if not {"depth", "pose"} <= dataset.modalities or len(dataset) < 2:
            pytest.skip("needs two frames with depth and pose")
        frames = list(dataset.frames())
        for other in reversed(frames[1:]):
            errors = _relative_errors(frames[0], other)
            if len(errors) >= 0.1 * frames[0].rgb[..., 0].numel():
                worst = float(errors.median())
                assert worst <= self.consistency, (
                    f"points of frame 0 miss the depth of frame {other.index} by {worst:.1%} (median): are poses "
                    "camera-to-world, axes OpenCV's, depth along z in metres?"
                )
                return
        pytest.skip("no frame sees a tenth of what the first one saw")

    def test_a_frame_belongs_to_who_read_it(self) -> None:
        dataset = self.make_dataset()
        first = frame_images(dataset[0])
        with torch.no_grad():
            dataset[0].rgb.zero_()
        changed = different_leaves(first, frame_images(dataset[0]))
        assert not changed, f"writing to a frame that was read changed {changed} of the next reading"

    def test_goes_to_another_process(self) -> None:
        dataset = self.make_dataset()
        other = pickle.loads(pickle.dumps(dataset))
        changed = different_leaves(frame_images(dataset[0]), frame_images(other[0]))
        assert not changed, f"the dataset reads another {changed} after pickling"

    def test_bounds_and_mesh_are_sound(self) -> None:
        dataset = self.make_dataset()
        if (bounds := dataset.bounds) is not None:
            assert bool((bounds[0] < bounds[1]).all()), f"bounds {bounds.tolist()} are not (min, max)"
        if (mesh := dataset.ground_truth_mesh) is not None:
            assert mesh.is_file(), f"the ground-truth mesh {mesh} does not exist"

    def test_a_damaged_frame_is_a_data_error(self) -> None:
        damaged = self.make_damaged()
        if damaged is None:
            pytest.skip("make_damaged() brings nothing")
        dataset, index = damaged
        with pytest.raises(DataError):
            dataset[index]

    def test_a_damaged_frame_can_be_skipped(self) -> None:
        damaged = self.make_damaged()
        if damaged is None:
            pytest.skip("make_damaged() brings nothing")
        dataset, index = damaged
        dataset.on_error = "skip"
        read = [frame.index for frame in dataset.frames()]
        assert read == [i for i in range(len(dataset)) if i != index]
        assert dataset.num_skipped == 1, f"one frame was skipped, num_skipped says {dataset.num_skipped}"


def _relative_errors(frame: Frame, other: Frame) -> Tensor:
    """Return |z - depth| / depth of the frame's points in the other's image, where that has a depth."""
    assert frame.T_world_camera_gt is not None
    assert other.T_world_camera_gt is not None
    assert other.depth is not None
    T_other_frame = se3.inverse(other.T_world_camera_gt.double()) @ frame.T_world_camera_gt.double()
    pixels, z = other.camera.project(se3.transform(T_other_frame, frame.points_camera().double()))
    seen = (z > 0) & other.camera.contains(pixels)
    u, v = pixels[seen].round().long().unbind(-1)
    measured = other.depth[v, u].double()
    return ((z[seen] - measured).abs() / measured)[measured > 0]
