"""General iterative optimisation as overridable steps: batch, losses, step, schedule, keep the best."""

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import torch
from torch import Tensor, nn

from xrdslam.core.adam import Adam

__all__ = [
    "GroupedOptimiser",
    "IterativeOptimisation",
    "Optimum",
    "ParameterGroup",
    "Schedule",
    "constant",
    "exponential_decay",
    "piecewise",
    "product",
]

Schedule = Callable[[int], float]
"""Maps an iteration to the factor on a group's learning rate."""
Problem = TypeVar("Problem")


def constant(_iteration: int) -> float:
    """Keep the learning rate."""
    return 1.0


def exponential_decay(final_factor: float, iterations: int) -> Schedule:
    """Let the factor fall from 1 to `final_factor` over `iterations`, geometrically."""
    return lambda iteration: float(final_factor ** min(1.0, iteration / max(1, iterations)))


def piecewise(factors: Sequence[tuple[int, float]]) -> Schedule:
    """Hold each factor from its iteration on: (0, 0.1), (60, 1.0) is a tenth for the first 60 iterations."""
    ordered = sorted(factors)
    return lambda iteration: next((f for start, f in reversed(ordered) if iteration >= start), 1.0)


def product(*schedules: Schedule) -> Schedule:
    """Multiply the factors of several schedules."""
    return lambda iteration: math.prod(schedule(iteration) for schedule in schedules)


@dataclass
class ParameterGroup:
    """Parameters that share a learning rate; a gradient is summed over `accumulate` iterations before each step."""

    name: str
    params: list[nn.Parameter]
    lr: float
    betas: tuple[float, float] = (0.9, 0.999)
    eps: float = 1e-8
    weight_decay: float = 0.0
    accumulate: int = 1
    schedule: Schedule = field(default=constant)


class GroupedOptimiser:
    """One Adam a group, so that each has its own schedule and accumulation; kept or built anew as the method says."""

    def __init__(self, groups: Sequence[ParameterGroup]) -> None:
        self.groups = [group for group in groups if group.params]
        self._optimisers = [Adam(group.params, group.betas, group.eps, group.weight_decay) for group in self.groups]

    def joined(self, other: "GroupedOptimiser") -> "GroupedOptimiser":
        """Return one optimiser that steps the groups of both and shares their moments."""
        both = GroupedOptimiser([])
        both.groups = self.groups + other.groups
        both._optimisers = self._optimisers + other._optimisers
        return both

    def zero_grad(self) -> None:
        """Forget every gradient."""
        for optimiser in self._optimisers:
            optimiser.zero_grad()

    def step(self, iteration: int) -> None:
        """Step every group that is due at `iteration` with its scheduled rate, and forget its gradient."""
        for group, optimiser in zip(self.groups, self._optimisers, strict=True):
            if (iteration + 1) % group.accumulate:
                continue
            optimiser.step(group.lr * group.schedule(iteration))
            optimiser.zero_grad()

    def moments(self, parameter: nn.Parameter) -> dict[str, Tensor]:
        """Return Adam's state tensors of a parameter, empty before its first step."""
        for optimiser in self._optimisers:
            if parameter in optimiser.state:
                return dict(optimiser.state[parameter])
        return {}

    def take_moments(self, other: "GroupedOptimiser") -> None:
        """Take over Adam's state of every parameter that both hold; parameters that were replaced start anew."""
        for mine, theirs in itertools.product(self._optimisers, other._optimisers):
            for parameter in mine.params:
                if parameter in theirs.state:
                    mine.state[parameter] = theirs.state[parameter]

    def state_dict(self) -> dict[str, Tensor]:
        """Return Adam's state of every parameter by its place, `<group>.<position>.<name>`, for checkpoints."""
        return {
            f"{index}.{position}.{name}": tensor
            for index, optimiser in enumerate(self._optimisers)
            for position, parameter in enumerate(optimiser.params)
            for name, tensor in optimiser.state.get(parameter, {}).items()
        }

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take over what `state_dict` of an optimiser with the same groups returned."""
        for key, tensor in state.items():
            index, position, name = key.split(".")
            optimiser = self._optimisers[int(index)]
            parameter = optimiser.params[int(position)]
            optimiser.state.setdefault(parameter, {})[name] = tensor.clone()

    def reindex_(self, old: nn.Parameter, new: nn.Parameter, rows: Tensor) -> None:
        """Put `new` = `old[rows]` in the place of `old`; moments and gradient follow their rows, so no step is lost."""
        new.grad = None if old.grad is None else old.grad[rows]
        for group, optimiser in zip(self.groups, self._optimisers, strict=True):
            for position, parameter in enumerate(group.params):
                if parameter is not old:
                    continue
                group.params[position] = new
                optimiser.params[position] = new
                state = optimiser.state.pop(old, {})
                optimiser.state[new] = {k: v[rows] if v.shape == old.shape else v for k, v in state.items()}


@dataclass
class Optimum:
    """How an optimisation ended. Tensors stay on their device; reading `loss` is the one synchronisation."""

    iterations: int
    loss: Tensor
    """The smallest total loss (with `keep_best`), else the last."""
    best: tuple[Tensor, ...]
    """The candidate of that loss."""

    @property
    def is_finite(self) -> bool:
        """Whether any iteration had a finite loss and candidate."""
        return bool(torch.isfinite(self.loss)) and all(bool(torch.isfinite(t).all()) for t in self.best)


class IterativeOptimisation(ABC, Generic[Problem]):
    """The loop that gradient-based tracking and mapping share; a method overrides the steps that differ.

    The candidate kept is the one whose loss was *measured*: it is copied before the step that leaves it. Best loss and
    candidate live on the device (`torch.where`), nothing is read back inside the loop.
    """

    keep_best: bool = False

    @abstractmethod
    def num_iterations(self, problem: Problem) -> int: ...

    @abstractmethod
    def groups(self, problem: Problem) -> list[ParameterGroup]:
        """Return what is optimised."""

    @abstractmethod
    def losses(self, problem: Problem, iteration: int) -> dict[str, Tensor]:
        """Draw a batch and return its weighted losses."""

    def optimiser(self, problem: Problem) -> GroupedOptimiser:
        """Build the optimiser (a method that keeps moments across calls returns its own)."""
        return GroupedOptimiser(self.groups(problem))

    def candidate(self, problem: Problem) -> tuple[Tensor, ...]:
        """Return what to keep when the loss is the best so far."""
        return ()

    def before_step(self, problem: Problem, optimiser: GroupedOptimiser, iteration: int) -> None:
        """Run after the backward pass: pruning, clipping."""

    def after_step(self, problem: Problem, optimiser: GroupedOptimiser, iteration: int) -> None:
        """Run after the parameters moved."""

    def should_stop(self, problem: Problem, iteration: int, loss: Tensor) -> bool:
        """Say whether to end early."""
        return False

    def optimise(self, problem: Problem) -> Optimum:
        """Run the loop."""
        optimiser = self.optimiser(problem)
        optimiser.zero_grad()  # an accumulation that an earlier call left unfinished is not this one's
        best_loss = torch.tensor(torch.inf)
        best: tuple[Tensor, ...] = ()
        done = 0
        for iteration in range(self.num_iterations(problem)):
            losses = self.losses(problem, iteration)
            total = torch.stack(tuple(losses.values())).sum()
            if total.requires_grad:
                total.backward()  # type: ignore[no-untyped-call]  # torch leaves it untyped
            best_loss, best = self._keep(total.detach(), self.candidate(problem), best_loss, best)
            self.before_step(problem, optimiser, iteration)
            optimiser.step(iteration)
            self.after_step(problem, optimiser, iteration)
            done = iteration + 1
            if self.should_stop(problem, iteration, total.detach()):
                break
        return Optimum(done, best_loss, best)

    def _keep(
        self, loss: Tensor, candidate: tuple[Tensor, ...], best_loss: Tensor, best: tuple[Tensor, ...]
    ) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Return the better of two, where what is not finite never wins; without `keep_best` the newest."""
        candidate = tuple(t.detach().clone() for t in candidate)
        for t in (loss, *candidate):  # a loss that leaves out what is not finite can be small for a candidate of NaN
            loss = torch.where(torch.isfinite(t).all(), loss, torch.nan)
        if not best or not self.keep_best:
            return loss, candidate
        better = (loss < best_loss) | best_loss.isnan()
        kept = tuple(torch.where(better, new, old) for new, old in zip(candidate, best, strict=True))
        return torch.where(better, loss, best_loss), kept
