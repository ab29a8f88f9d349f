"""Virtual event loop: exact, without real waiting, and never endless."""

from __future__ import annotations

import asyncio
import time

import pytest

from drivebus.testing.virtual_time import CallbackError, Deadlock, VirtualLoop, run


def test_a_virtual_day_passes_at_once_and_exactly() -> None:
    async def main() -> float:
        await asyncio.sleep(86400)
        return asyncio.get_running_loop().time()

    begun = time.perf_counter()
    assert run(main(), start=5.0) == 86405.0
    assert time.perf_counter() - begun < 10


def test_timers_run_in_order_each_at_its_own_time() -> None:
    async def main() -> list[tuple[str, float]]:
        loop = asyncio.get_running_loop()
        calls: list[tuple[str, float]] = []
        loop.call_at(0.3, lambda: calls.append(("late", loop.time())))
        loop.call_at(0.1, lambda: calls.append(("early", loop.time())))
        await asyncio.sleep(1)
        return calls

    assert run(main()) == [("early", 0.1), ("late", 0.3)]


def test_a_timeout_ends_at_its_exact_virtual_time() -> None:
    async def main() -> float:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(2.5):
                await asyncio.Event().wait()
        return asyncio.get_running_loop().time()

    assert run(main()) == 2.5


def test_waiting_for_an_event_that_never_happens_raises_and_names_the_task() -> None:
    async def main() -> None:
        asyncio.current_task().set_name("the waiting task")  # type: ignore[union-attr]
        await asyncio.Event().wait()

    with pytest.raises(Deadlock, match="the waiting task"):
        run(main())


def test_waiting_past_the_longest_time_is_an_error() -> None:
    async def main() -> None:
        while True:  # noqa: ASYNC110
            await asyncio.sleep(1)

    with pytest.raises(Deadlock, match="longest"):
        run(main(), max_s=10)


def test_a_function_for_a_thread_runs_at_once() -> None:
    async def main() -> int:
        return await asyncio.get_running_loop().run_in_executor(None, lambda: 7)

    assert run(main()) == 7


def test_an_error_in_the_coroutine_is_raised() -> None:
    async def main() -> None:
        await asyncio.sleep(1)
        raise KeyError("x")

    with pytest.raises(KeyError):
        run(main())


def test_a_timer_can_cancel_another_one_of_the_same_instant() -> None:
    async def main() -> list[str]:
        loop = asyncio.get_running_loop()
        calls: list[str] = []
        second: list[asyncio.TimerHandle] = []
        loop.call_at(1.0, lambda: (calls.append("first"), second[0].cancel()))
        second.append(loop.call_at(1.0, calls.append, "second"))
        loop.call_at(1.0, calls.append, "third")
        await asyncio.sleep(2)
        return calls

    assert run(main()) == ["first", "third"]


def test_a_call_soon_of_a_timer_comes_after_the_other_timers_of_its_instant() -> None:
    async def main() -> list[str]:
        loop = asyncio.get_running_loop()
        calls: list[str] = []
        loop.call_at(1.0, loop.call_soon, calls.append, "soon")
        loop.call_at(1.0, calls.append, "timer")
        await asyncio.sleep(2)
        return calls

    assert run(main()) == ["timer", "soon"]


def test_a_timer_that_is_set_in_the_past_runs_now_and_time_does_not_go_back() -> None:
    async def main() -> list[float]:
        loop = asyncio.get_running_loop()
        times: list[float] = []
        await asyncio.sleep(5)
        loop.call_at(1.0, lambda: times.append(loop.time()))
        loop.call_at(6.0, lambda: times.append(loop.time()))
        await asyncio.sleep(2)
        return times

    assert run(main()) == [5.0, 6.0]


def test_running_until_a_time_leaves_later_timers_and_ends_at_that_time() -> None:
    loop = VirtualLoop()
    times: list[float] = []
    for when in (1.0, 2.0, 2.5):
        loop.call_at(when, lambda: times.append(loop.time()))
    loop.run_until(2.0)
    assert (times, loop.time(), loop.next_at()) == ([1.0, 2.0], 2.0, 2.5)


def test_a_future_that_a_timer_resolves_ends_the_run_at_its_time_though_other_timers_go_on() -> None:
    loop = VirtualLoop(max_s=10.0)
    future = loop.create_future()

    def go_on() -> None:
        loop.call_later(0.5, go_on)

    go_on()
    loop.call_at(2.2, future.set_result, "reply")
    assert (loop.run_until_complete(future), loop.time()) == ("reply", 2.2)


def test_an_exception_of_a_callback_ends_the_test_at_once_instead_of_waiting_for_what_it_should_have_done() -> None:
    ended_at: list[float] = []

    async def main() -> None:
        loop = asyncio.get_running_loop()
        loop.call_later(2.0, lambda: 1 / 0)
        try:
            await asyncio.sleep(3 * 86400)
        finally:
            ended_at.append(loop.time())

    with pytest.raises(CallbackError, match="Exception in callback") as caught:
        run(main())
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    assert ended_at == [2.0]


def test_an_exception_that_a_handler_takes_does_not_end_the_test() -> None:
    reports: list[object] = []

    async def main() -> str:
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: reports.append(context["exception"]))
        loop.call_soon(lambda: 1 / 0)
        await asyncio.sleep(1)
        return "done"

    assert run(main()) == "done"
    assert [type(report) for report in reports] == [ZeroDivisionError]
