"""Being told to end: after this frame, or now if asked again or if the frame takes too long."""

import signal
import time
from collections.abc import Iterator

import pytest

from xrdslam.engine.interruption import GRACE_S, Interruption


@pytest.fixture(autouse=True)
def _default_handlers() -> Iterator[None]:
    """A shell's background jobs ignore SIGINT, and what is ignored is left so."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_the_first_signal_waits_for_the_frame_and_the_second_does_not(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with Interruption(again_s=0.0) as interruption:
        with interruption.breaking(GRACE_S):
            interruption.check()
            signal.raise_signal(number)
            with pytest.raises(KeyboardInterrupt):
                interruption.check()
            interruption.check()
            signal.raise_signal(number)
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(number)
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    assert signal.getsignal(number) is before


def test_a_process_and_its_group_are_sent_one_signal_twice() -> None:
    with Interruption() as interruption, interruption.breaking(GRACE_S):
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            interruption.check()
        interruption.check()


def test_a_frame_that_does_not_end_is_ended() -> None:
    start = time.perf_counter()
    with Interruption() as interruption, interruption.breaking(0.05):
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            time.sleep(30)
    assert time.perf_counter() - start < 10


def test_without_a_grace_it_is_now_and_what_came_before_counts() -> None:
    with Interruption(again_s=0.0) as interruption:
        with pytest.raises(KeyboardInterrupt), interruption.breaking(0.0):
            signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)  # between two steps: noted
        with pytest.raises(KeyboardInterrupt), interruption.breaking(0.0):
            pytest.fail("the step is not begun")
        interruption.check()


def test_what_is_shielded_is_brought_to_its_end_however_often_it_is_asked() -> None:
    done = []
    with Interruption(again_s=0.0) as interruption:
        with interruption.breaking(0.01), interruption.shielded():
            for _ in range(3):
                signal.raise_signal(signal.SIGINT)
            done.append("all processes ended")
        with pytest.raises(KeyboardInterrupt):
            interruption.check()
    assert done


def test_a_job_that_its_shell_lets_ignore_a_signal_goes_on_ignoring_it() -> None:
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    with Interruption() as interruption:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGHUP)
        interruption.check()
