"""Rooms are what they say, and a short lesson teaches."""

import torch

from xrdslam.algorithms.nice_slam.pretrain import Lesson, Teaching, descend, wrong_share
from xrdslam.algorithms.nice_slam.rooms import random_room
from xrdslam.ops.feature_decoder import FeatureDecoder


def test_a_room_is_hollow_and_its_walls_are_solid() -> None:
    room = random_room(torch.Generator().manual_seed(0))._replace(boxes=torch.zeros(0, 6), balls=torch.zeros(0, 4))
    room = room._replace(turns=torch.zeros(0, 3, 3))
    wall = room.center_world + room.rotation @ (room.half * torch.tensor([1.0, 0, 0]))
    outwards = room.rotation[:, 0]
    points = torch.stack((room.center_world, wall - 0.1 * outwards, wall + 0.2 * outwards))
    expected = torch.tensor([float(room.half.min()), 0.1, -0.2])
    torch.testing.assert_close(room.distance(points), expected, rtol=0, atol=1e-5)


def test_a_short_lesson_teaches_occupancy() -> None:
    generator = torch.Generator().manual_seed(0)
    decoders = FeatureDecoder(32, 1, generator), FeatureDecoder(64, 1, generator)
    lesson = Lesson(random_room(generator, 0.5), 0.32, generator, num_points=4000)
    optimiser = torch.optim.Adam([p for d in decoders for p in d.parameters()])
    before = wrong_share([lesson], decoders)
    descend([lesson], decoders, Teaching(steps=40, points=1500), generator, optimiser, 1.0)
    assert max(wrong_share([lesson], decoders)) < min(0.2, *before)
