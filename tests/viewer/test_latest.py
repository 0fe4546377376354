"""Newest wins, nobody waits, and time is spent by its share."""

import threading

import pytest

from xrdslam.viewer.latest import Budget, Latest


def test_what_was_not_taken_is_dropped_and_counted() -> None:
    slot: Latest[int] = Latest()
    for number in range(5):
        slot.put(number)
    assert slot.take() == 4
    assert slot.dropped == 4


def test_a_closed_slot_gives_what_it_holds_and_then_nothing() -> None:
    slot: Latest[str] = Latest()
    slot.put("last")
    slot.close()
    assert slot.take() == "last"
    assert slot.take() is None


def test_taking_waits_for_an_item() -> None:
    slot: Latest[int] = Latest()
    taken: list[int | None] = []
    thread = threading.Thread(target=lambda: taken.append(slot.take()))
    thread.start()
    slot.put(7)
    thread.join(timeout=10)
    assert taken == [7]


@pytest.mark.parametrize("share", [0.02, 0.5])
def test_a_budget_spends_its_share_whatever_a_piece_costs(share: float) -> None:
    now = [0.0]
    budget = Budget(share, lambda: now[0])
    spent = 0.0
    for _ in range(10_000):
        now[0] += 0.01
        if budget.is_open:
            with budget.spending():
                now[0] += 0.3
            spent += 0.3
    assert budget.spent_s == pytest.approx(spent)
    assert spent / now[0] == pytest.approx(share, rel=0.05)  # a piece of 0.3 s in at least 100 s is 0.3 %
