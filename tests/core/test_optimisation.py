"""The general optimisation: schedules, accumulation, moments that follow their rows, the best measured candidate."""

import math
from collections.abc import Sequence

import pytest
import torch
from torch import Tensor, nn

from xrdslam.core.optimisation import (
    GroupedOptimiser,
    IterativeOptimisation,
    Optimum,
    ParameterGroup,
    constant,
    exponential_decay,
    piecewise,
)


def parameter(values: Sequence[float] = (1.0, -2.0, 3.0)) -> nn.Parameter:
    return nn.Parameter(torch.tensor(values))


def adam_by_hand(start: Tensor, gradients: Sequence[Tensor], rates: Sequence[float]) -> Tensor:
    """Kingma & Ba's algorithm 1, written out."""
    x, m, v = start.clone(), torch.zeros_like(start), torch.zeros_like(start)
    for t, (g, lr) in enumerate(zip(gradients, rates, strict=True), start=1):
        m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g * g
        x = x - lr * (m / (1 - 0.9**t)) / ((v / (1 - 0.999**t)).sqrt() + 1e-8)
    return x


def draws(count: int, seed: int = 0) -> list[Tensor]:
    return list(torch.randn(count, 3, generator=torch.Generator().manual_seed(seed)))


def test_schedules() -> None:
    assert [constant(i) for i in (0, 10)] == [1.0, 1.0]
    decay = exponential_decay(0.01, 100)
    assert [decay(i) for i in (0, 100, 500)] == [1.0, 0.01, 0.01]
    assert math.isclose(decay(50), 0.1)
    assert exponential_decay(0.5, 0)(0) == 1.0
    steps = piecewise([(60, 1.0), (0, 0.1)])
    assert [steps(i) for i in (0, 59, 60, 1000)] == [0.1, 0.1, 1.0, 1.0]
    assert piecewise([(5, 0.1)])(4) == 1.0


def test_a_step_is_adams_with_the_scheduled_rate() -> None:
    x, gradients = parameter(), draws(5)
    optimiser = GroupedOptimiser([ParameterGroup("x", [x], 0.1, schedule=exponential_decay(0.1, 4))])
    expected = adam_by_hand(x.detach(), gradients, [0.1 * 10 ** (-i / 4) for i in range(5)])
    for iteration, gradient in enumerate(gradients):
        x.grad = gradient.clone()
        optimiser.step(iteration)
        assert x.grad is None
    torch.testing.assert_close(x.detach(), expected)


def test_accumulating_is_one_step_on_the_summed_gradient() -> None:
    gradients = draws(6)
    sums = [gradients[0] + gradients[1] + gradients[2], gradients[3] + gradients[4] + gradients[5]]
    x = parameter()
    expected = adam_by_hand(x.detach(), sums, [0.1, 0.1])
    optimiser = GroupedOptimiser([ParameterGroup("x", [x], 0.1, accumulate=3)])
    for iteration, gradient in enumerate(gradients):
        (x * gradient).sum().backward()
        optimiser.step(iteration)
    torch.testing.assert_close(x.detach(), expected)


def test_each_group_keeps_its_own_rhythm() -> None:
    often, seldom = parameter(), parameter()
    groups = [ParameterGroup("often", [often], 0.1), ParameterGroup("seldom", [seldom], 0.1, accumulate=2)]
    optimiser = GroupedOptimiser(groups)
    ((often + seldom) ** 2).sum().backward()
    optimiser.step(0)
    assert not torch.equal(often.detach(), parameter().detach())
    assert torch.equal(seldom.detach(), parameter().detach())
    assert often.grad is None
    assert seldom.grad is not None


def test_groups_without_parameters_are_left_out() -> None:
    assert GroupedOptimiser([ParameterGroup("none", [], 0.1)]).groups == []


@pytest.mark.parametrize("rows", [torch.tensor([0, 2]), torch.tensor([True, False, True]), torch.tensor([2, 0])])
def test_dropping_rows_is_never_having_had_them(rows: Tensor) -> None:
    """Adam works row by row: what is kept goes on as if the dropped rows had never been there."""
    full, kept = parameter(), nn.Parameter(parameter().detach()[rows])
    optimisers = [GroupedOptimiser([ParameterGroup("x", [p], 0.1, accumulate=2)]) for p in (full, kept)]
    for iteration, gradient in enumerate(draws(3)):  # the third is half an accumulation
        (full * gradient).sum().backward()
        (kept * gradient[rows]).sum().backward()
        for optimiser in optimisers:
            optimiser.step(iteration)
    pruned = nn.Parameter(full.detach()[rows])
    optimisers[0].reindex_(full, pruned, rows)
    for iteration, gradient in enumerate(draws(5, seed=1), start=3):
        (pruned * gradient[rows]).sum().backward()
        (kept * gradient[rows]).sum().backward()
        for optimiser in optimisers:
            optimiser.step(iteration)
    assert torch.equal(pruned, kept)
    assert optimisers[0].groups[0].params[0] is pruned
    assert optimisers[0].moments(full) == {}


def test_dropping_rows_before_the_first_step_or_all_of_them() -> None:
    x = parameter()
    optimiser = GroupedOptimiser([ParameterGroup("x", [x], 0.1)])
    for new, rows in (
        (nn.Parameter(x.detach()[1:]), torch.tensor([1, 2])),
        (nn.Parameter(torch.zeros(0)), torch.zeros(0).long()),
    ):
        optimiser.reindex_(x, new, rows)
        new.sum().backward()
        optimiser.step(0)
        x = new
    assert x.shape == (0,)


def test_joined_optimisers_step_together_and_share_moments() -> None:
    x, y = parameter(), parameter()
    a, b = (GroupedOptimiser([ParameterGroup(name, [p], 0.1)]) for name, p in (("x", x), ("y", y)))
    both = a.joined(b)
    (x.sum() + y.sum()).backward()
    both.step(0)
    torch.testing.assert_close(x.detach(), parameter().detach() - 0.1)  # Adam's first step is the rate
    assert torch.equal(x, y)
    assert a.moments(x)["exp_avg"] is both.moments(x)["exp_avg"]
    assert b.moments(x) == {}


def test_moments_go_over_to_an_optimiser_built_anew() -> None:
    gradients = draws(4)
    x, gone = parameter(), parameter()
    expected = adam_by_hand(x.detach(), gradients, [0.1, 0.1, 0.2, 0.2])
    old = GroupedOptimiser([ParameterGroup("x", [x, gone], 0.1)])
    for iteration in range(2):
        x.grad, gone.grad = gradients[iteration].clone(), gradients[iteration].clone()
        old.step(iteration)
    new = GroupedOptimiser([ParameterGroup("y", [parameter()], 1.0), ParameterGroup("x", [x], 0.2)])
    new.take_moments(old)
    for iteration in range(2, 4):
        x.grad = gradients[iteration].clone()
        new.step(iteration)
    torch.testing.assert_close(x.detach(), expected)


def test_state_goes_through_a_dictionary_of_tensors() -> None:
    def build() -> tuple[nn.Parameter, nn.Parameter, GroupedOptimiser]:
        x, y = parameter(), parameter()
        return x, y, GroupedOptimiser([ParameterGroup("x", [x], 0.1), ParameterGroup("y", [y], 0.2)])

    x, y, first = build()
    for iteration, gradient in enumerate(draws(3)):
        x.grad, y.grad = gradient.clone(), 2 * gradient
        first.step(iteration)
    x2, y2, second = build()
    with torch.no_grad():
        x2.copy_(x)
        y2.copy_(y)
    second.load_state_dict(first.state_dict())
    for p, q in ((x, y), (x2, y2)):
        p.grad, q.grad = torch.ones(3), torch.ones(3)
    first.step(3)
    second.step(3)
    assert torch.equal(x, x2)
    assert torch.equal(y, y2)
    assert build()[2].state_dict() == {}


class Descent(IterativeOptimisation[nn.Parameter]):
    """Adam on a sequence of measured losses, or on x^2."""

    def __init__(
        self, iterations: int, lr: float = 0.1, measured: Sequence[float] | None = None, best: bool = True
    ) -> None:
        self.iterations, self.lr, self.measured, self.keep_best = iterations, lr, measured, best
        self.seen: list[float] = []

    def num_iterations(self, problem: nn.Parameter) -> int:
        return self.iterations

    def groups(self, problem: nn.Parameter) -> list[ParameterGroup]:
        return [ParameterGroup("x", [problem], self.lr)]

    def losses(self, problem: nn.Parameter, iteration: int) -> dict[str, Tensor]:
        square = (problem**2).sum()
        loss = square if self.measured is None else 0 * square + self.measured[iteration]
        self.seen.append(float(loss.detach()))
        return {"loss": loss}

    def candidate(self, problem: nn.Parameter) -> tuple[Tensor, ...]:
        return (problem,)


def test_the_best_measured_candidate_is_kept_not_the_one_after_its_step() -> None:
    """A rate that overshoots: x goes 1, 0.4, -0.2, ... and back up; the loss is that of the x that is returned."""
    x = parameter([1.0])
    descent = Descent(6, lr=0.6)
    optimum = descent.optimise(x)
    assert float(optimum.loss) == min(descent.seen)
    assert float(optimum.best[0].square()) == float(optimum.loss)
    assert descent.seen[-1] > min(descent.seen), "the last step was to overshoot"
    assert optimum.iterations == 6


def test_the_last_measured_candidate_is_kept_where_the_best_is_not_asked_for() -> None:
    descent = Descent(6, lr=0.6, best=False)
    optimum = descent.optimise(parameter([1.0]))
    assert float(optimum.loss) == descent.seen[-1] == float(optimum.best[0].square())


@pytest.mark.parametrize(
    ("measured", "best"),
    [
        ([3.0, 2.0, 1.0], 2),
        ([1.0, 2.0, 3.0], 0),
        ([2.0, 2.0, 2.0], 0),
        ([math.nan, 2.0, 3.0], 1),
        ([3.0, math.nan, 2.0], 2),
        ([math.nan, math.nan, 5.0], 2),
        ([math.inf, math.nan, 5.0], 2),
        ([2.0, -math.inf, 1.0], 2),
    ],
)
def test_a_loss_that_is_not_finite_never_wins(measured: list[float], best: int) -> None:
    class Count(Descent):
        def candidate(self, problem: nn.Parameter) -> tuple[Tensor, ...]:
            return (torch.tensor(float(len(self.seen) - 1)),)

    optimum = Count(3, measured=measured).optimise(parameter())
    assert float(optimum.best[0]) == best
    assert float(optimum.loss) == measured[best]


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("best", [True, False])
def test_without_any_finite_loss_the_optimum_is_not_finite(bad: float, best: bool) -> None:
    assert not Descent(3, measured=[bad] * 3, best=best).optimise(parameter()).is_finite
    assert Descent(3, measured=[1.0] * 3, best=best).optimise(parameter()).is_finite


@pytest.mark.parametrize("spoilt", [0, 1, 2])
def test_a_candidate_of_nan_never_wins_however_small_its_loss(spoilt: int) -> None:
    """A loss that leaves out pixels that are not finite is 0 where none is left."""

    class Blind(Descent):
        def candidate(self, problem: nn.Parameter) -> tuple[Tensor, ...]:
            return (torch.tensor(math.nan if len(self.seen) - 1 == spoilt else 7.0),)

    optimum = Blind(3, measured=[0.0 if i == spoilt else 5.0 for i in range(3)]).optimise(parameter())
    assert optimum.is_finite
    assert float(optimum.best[0]) == 7.0


def test_no_iterations_find_nothing() -> None:
    optimum = Descent(0).optimise(parameter())
    assert optimum.iterations == 0
    assert not optimum.is_finite
    assert not Optimum(1, torch.tensor(1.0), (torch.tensor(torch.nan),)).is_finite


def test_gradients_left_from_before_do_not_count() -> None:
    """An accumulation that an earlier call left unfinished, or anyone else's backward pass."""
    x, y = parameter([1.0]), parameter([1.0])
    x.grad = torch.tensor([100.0])
    for p in (x, y):
        Descent(1).optimise(p)
    assert torch.equal(x, y)


def test_the_hooks_run_around_each_step_and_end_it_early() -> None:
    calls: list[str] = []

    class Hooked(Descent):
        def before_step(self, problem: nn.Parameter, optimiser: GroupedOptimiser, iteration: int) -> None:
            assert problem.grad is not None
            calls.append(f"before {iteration}: {float(problem.detach()):.1f}")

        def after_step(self, problem: nn.Parameter, optimiser: GroupedOptimiser, iteration: int) -> None:
            calls.append(f"after {iteration}: {float(problem.detach()):.1f}")

        def should_stop(self, problem: nn.Parameter, iteration: int, loss: Tensor) -> bool:
            return iteration == 1

    assert Hooked(5).optimise(parameter([1.0])).iterations == 2
    assert calls == ["before 0: 1.0", "after 0: 0.9", "before 1: 0.9", "after 1: 0.8"]


def test_a_method_may_keep_its_optimiser_between_calls() -> None:
    """Two calls of three iterations with kept moments are one call of six."""

    class Kept(Descent):
        kept: GroupedOptimiser | None = None

        def optimiser(self, problem: nn.Parameter) -> GroupedOptimiser:
            self.kept = self.kept or super().optimiser(problem)
            return self.kept

    x, y = parameter([1.0, 5.0, -2.0]), parameter([1.0, 5.0, -2.0])
    twice, once = Kept(3), Descent(6)
    twice.optimise(x)
    twice.optimise(x)
    once.optimise(y)
    assert torch.equal(x, y)
