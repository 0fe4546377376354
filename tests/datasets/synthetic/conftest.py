"""A small closed world for the ray caster, and the living room in coarse light."""

import pytest

from xrdslam.datasets.synthetic.config import SyntheticConfig
from xrdslam.datasets.synthetic.dataset import SyntheticDataset
from xrdslam.datasets.synthetic.lighting import LightingConfig, bake, light_up
from xrdslam.datasets.synthetic.scene import Light, Material, Pattern, Scene, Shape, Solid, rotation
from xrdslam.datasets.synthetic.shading import World

COARSE = LightingConfig(spacing=0.4, light_samples=2, gather_rays=8, bounces=1)
GREY = Material(Pattern.PLAIN, ("#808080", "#808080", "#808080"), 1.0, 0.0)
SPHERE = (0.5, (1.0, 0.3, 1.2))
"""radius, centre"""
BOX = ((0.4, 0.3, 0.5), (-1.0, 0.4, 1.0), rotation(30.0))
"""half extents, centre, R_world_local"""


@pytest.fixture(scope="session")
def toy_scene() -> Scene:
    solids = (
        Solid(Shape.BOX, (0.0, 0.0, 0.0), SPHERE[0], (GREY,), SPHERE[1]),
        Solid(Shape.BOX, BOX[0], 0.0, (GREY,), BOX[1], BOX[2]),
        Solid(Shape.FRUSTUM, (0.3, 0.1, 0.4), 0.05, (GREY,), (0.0, -1.2, 0.5)),
        Solid(Shape.BOX, (0.2, 0.1, 0.3), 0.15, (GREY,), (0.2, 1.2, 0.6), rotation(20.0, 40.0, 10.0)),
    )
    light = Light((0.0, 0.0, 2.99), (0.5, 0.0, 0.0), (0.0, -0.5, 0.0), (9.0, 9.0, 9.0))
    return Scene("toy", (5.0, 4.0, 3.0), (GREY,), solids, (light,))


@pytest.fixture(scope="session")
def toy_world(toy_scene: Scene) -> World:
    packed = toy_scene.pack()
    return light_up(packed, bake(packed, COARSE))


@pytest.fixture
def room(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> SyntheticDataset:
    """The living room at 96 x 72, its cache shared by the session."""
    monkeypatch.setenv("XRDSLAM_CACHE", str(tmp_path_factory.getbasetemp() / "synthetic"))
    return SyntheticDataset(SyntheticConfig(num_frames=40, width=96, height=72, lighting="coarse"))
