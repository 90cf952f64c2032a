"""Threads on a simulated clock: in order, one at a time, without waiting."""

import math
import time

import pytest

from dream.robots.bluerov2.standin.lockstep import LockStep, Stuck


def test_sleepers_wake_in_the_order_of_their_times_and_the_clock_says_when() -> None:
    clock, woke = LockStep(5.0), []

    def sleeper(seconds: float) -> None:
        clock.sleep(seconds)
        woke.append((seconds, clock()))

    began = time.monotonic()
    threads = [clock.start(lambda s=s: sleeper(s), f"{s}") for s in (300.0, 0.5, 20.0)]  # type: ignore[misc]
    for thread in threads:
        thread.join()
    assert woke == [(0.5, 5.5), (20.0, 25.0), (300.0, 305.0)]
    assert time.monotonic() - began < 100.0


def test_one_runs_at_a_time_and_computing_takes_no_time() -> None:
    clock, inside, seen = LockStep(), [0], []

    def work() -> None:
        for _ in range(200):
            inside[0] += 1
            seen.append((inside[0], clock()))
            sum(range(200))
            inside[0] -= 1
            clock.sleep(0.01)

    threads = [clock.start(work, f"{n}") for n in range(5)]
    for thread in threads:
        thread.join()
    assert {count for count, _ in seen} == {1}
    assert clock() == pytest.approx(2.0)
    assert len({round(at, 6) for _, at in seen}) == 200


def test_it_takes_the_same_course_every_time() -> None:
    def course() -> list[tuple[float, str]]:
        clock, told = LockStep(), []
        news = clock.condition()

        def say(name: str, every: float) -> None:
            for _ in range(20):
                clock.sleep(every)
                with news:
                    told.append((clock(), name))
                    news.notify_all()

        def hear() -> None:
            with news:
                while len(told) < 80:
                    news.wait(0.07)
                    told.append((clock(), "heard"))

        threads = [clock.start(lambda: say("a", 0.03), "a"), clock.start(lambda: say("b", 0.05), "b")]
        threads.append(clock.start(hear, "c"))
        for thread in threads:
            thread.join()
        return told

    assert course() == course()


def test_an_event_ends_a_wait_and_a_timeout_ends_it_without() -> None:
    clock = LockStep()
    event = clock.event()
    assert not event.wait(1.5)
    assert clock() == 1.5

    def set_late() -> None:
        clock.sleep(2.0)
        event.set()

    clock.start(set_late, "sets")
    assert event.wait(10.0)
    assert clock() == 3.5
    # What waited is not woken a second time by the time-out that it had.
    clock.sleep(20.0)
    assert clock() == 23.5


def test_a_lock_keeps_others_out_while_its_owner_sleeps_and_may_be_taken_twice() -> None:
    clock, order = LockStep(), []
    lock = clock.lock()

    def hold() -> None:
        with lock, lock:
            order.append("in")
            clock.sleep(3.0)
            order.append("out")

    thread = clock.start(hold, "holds")
    clock.sleep(1.0)
    with lock:
        order.append("mine")
        assert clock() == 3.0
    thread.join()
    assert order == ["in", "out", "mine"]


def test_a_condition_lets_go_of_its_lock_while_it_waits_and_has_it_again_after() -> None:
    clock, told = LockStep(), []
    news = clock.condition()

    def tell() -> None:
        clock.sleep(1.0)
        with news:
            told.append(1)
            news.notify_all()
            clock.sleep(2.0)
            told.append(2)

    clock.start(tell, "tells")
    with news, news:
        assert news.wait_for(lambda: bool(told), 10.0)
        assert told == [1, 2]
        assert clock() == 3.0
        assert not news.wait_for(lambda: len(told) > 2, 4.0)
        assert clock() == 7.0


def test_who_waits_for_a_thread_goes_on_at_its_end_or_at_the_timeout() -> None:
    clock = LockStep()
    thread = clock.start(lambda: clock.sleep(5.0), "sleeps")
    thread.join(1.0)
    assert thread.is_alive()
    assert clock() == 1.0
    thread.join()
    assert not thread.is_alive()
    assert clock() == 5.0


def test_an_interrupt_meets_the_first_thread_where_it_waits() -> None:
    clock = LockStep()

    def press() -> None:
        clock.sleep(2.0)
        clock.interrupt()

    clock.start(press, "interrupts")
    with pytest.raises(KeyboardInterrupt):
        clock.sleep(100.0)
    assert clock() == 2.0
    clock.sleep(1.0)
    assert clock() == 3.0


def test_threads_that_wait_for_each_other_are_told() -> None:
    clock = LockStep()
    with pytest.raises(Stuck):
        clock.event().wait()
    thread = clock.start(lambda: clock.block(math.inf), "for ever")
    with pytest.raises(Stuck):
        thread.join()
