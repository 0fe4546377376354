"""Depths along rays: order, range, and where importance puts them."""

import torch

from xrdslam.ops.sampling import importance_depths, jittered, linear_depths, merged


def test_linear_depths_include_both_ends() -> None:
    depths = linear_depths(torch.tensor([0.0, 1.0]), torch.tensor([4.0, 1.0]), 5)
    torch.testing.assert_close(depths, torch.tensor([[0.0, 1, 2, 3, 4], [1, 1, 1, 1, 1]]))


def test_merged_depths_are_in_order() -> None:
    a, b = torch.rand(2, 50, 7, generator=torch.Generator().manual_seed(0)).sort(2).values
    both = merged(a, b)
    assert both.shape == (50, 14)
    assert (both.diff(dim=1) >= 0).all()


def test_jittered_depths_stay_between_their_neighbours_middles() -> None:
    depths = torch.rand(200, 9, generator=torch.Generator().manual_seed(0)).sort(1).values
    drawn = jittered(depths, torch.Generator().manual_seed(1))
    middles = (depths[:, 1:] + depths[:, :-1]) / 2
    assert (drawn[:, :-1] <= middles + 1e-7).all()
    assert (drawn[:, 1:] >= middles - 1e-7).all()
    assert (drawn[:, 0] >= depths[:, 0]).all()
    assert (drawn[:, -1] <= depths[:, -1]).all()
    again = jittered(depths, torch.Generator().manual_seed(1))
    assert torch.equal(drawn, again)


def test_one_depth_has_no_interval() -> None:
    depths = torch.tensor([[1.0], [2.0]])
    assert torch.equal(jittered(depths, torch.Generator()), depths)


def test_importance_goes_where_the_weight_is() -> None:
    depths = torch.linspace(0, 10, 11).repeat(3, 1)
    weights = torch.zeros(3, 11)
    weights[0, 4] = 1.0
    weights[1] = 1.0
    drawn = importance_depths(depths, weights, 64)
    assert (drawn[0] > 3.4).all()
    assert (drawn[0] < 4.6).all()
    for ray in (1, 2):  # even weights, and none
        assert drawn[ray].min() < 0.5
        assert drawn[ray].max() > 9.5
    assert (drawn.diff(dim=1) >= 0).all()
    random = importance_depths(depths, weights, 64, torch.Generator().manual_seed(0))
    assert ((random >= 0) & (random <= 10)).all()
