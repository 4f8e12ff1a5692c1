"""rclpy's executor of one thread, at a fifth of its cost for each message.

rclpy's own gathers every topic, timer and service of a node for each wait, and wakes itself after
each callback in case another thread waits, so that it does all of it twice. With one thread nobody
else waits; and what is waited for changes only when something is created or destroyed, of which
nodes tell the executor.
"""

import inspect
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.subscription import Subscription
from rclpy.waitable import NumberOfEntities

_FOREVER_NS = -1
_MESSAGE_ONLY = Subscription.CallbackType.MessageOnly


class LeanExecutor(SingleThreadedExecutor):
    """Runs the callbacks of nodes in the thread that calls `spin`, as its base class does."""

    def __init__(self, *, context: Context | None = None) -> None:
        super().__init__(context=context)
        self._waiting: _WaitList | None = None

    def spin(self) -> None:
        """Runs callbacks until the executor or its context is shut.

        Raises:
            ExternalShutdownException: The context was shut.
        """
        try:
            while self._context.ok() and not self._is_shutdown:
                self.spin_once()
        finally:
            self._forget()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Waits until something is ready and runs all that is; with a limit as the base class."""
        if timeout_sec is not None:
            # It may take the word that something was created.
            self._forget()
            super().spin_once(timeout_sec)
            return
        self._cb_iter = None
        left = self._go_on()
        if self._waiting is None or self._waiting.is_stale or self._waiting.beside != left:
            self._forget()
            self._waiting = _WaitList(self, left)
        for run in self._waiting.wait():
            if self._is_shutdown or not self._context.ok():
                return
            run()

    def _go_on(self) -> list[Any]:
        """Goes on with coroutines that wait for something; returns those that still do."""
        if not self._tasks:
            return []
        with self._tasks_lock:
            tasks = [task for task, _, _ in self._tasks]
        for task in tasks:
            _finish(task)
        with self._tasks_lock:
            self._tasks = [item for item in self._tasks if not _is_over(item[0])]
            return [task for task, _, _ in self._tasks]

    def _forget(self) -> None:
        if self._waiting is not None:
            self._waiting.close()
            self._waiting = None

    def _take_waitable(self, waitable: Any) -> Any:
        # Destroyed by another thread or callback since it was ready, it is not run.
        with suppress(InvalidHandle):
            return super()._take_waitable(waitable)
        return None

    def runner(self, entity: Any, node: Any, take: Any) -> Callable[[], None]:
        """Returns what runs an entity that is ready: as a task, which may wait for something."""

        def run() -> None:
            if entity.callback_group.can_execute(entity):
                _finish(self._make_handler(entity, node, take))

        return run

    def entities(self) -> dict[str, list[tuple[Any, Callable[[], None]]]]:
        """Returns what can be waited for and what runs it, by kind, in the order of running.

        What has to wait with a coroutine of its group is left out.
        """
        found: dict[str, list[tuple[Any, Callable[[], None]]]] = {}
        for node in self.get_nodes():
            for kind, entities, take, fast in (
                ("waitable", node.waitables, self._take_waitable, None),
                ("timer", node.timers, self._take_timer, _due),
                ("subscription", node.subscriptions, self._take_subscription, _received),
                ("guard_condition", node.guards, self._take_guard_condition, None),
                ("client", node.clients, self._take_client, None),
                ("service", node.services, self._take_service, None),
            ):
                for entity in entities:
                    if not self.can_execute(entity):
                        continue
                    if fast is None or inspect.iscoroutinefunction(entity.callback):
                        run = self.runner(entity, node, take)
                    else:
                        run = _direct(fast, entity)
                    found.setdefault(kind, []).append((entity, run))
        return found

    def own_guards(self) -> list[Any]:
        """Returns the guards with which the executor is woken."""
        return [guard for guard in (self._guard, self._sigint_gc) if guard is not None]

    @property
    def is_shut(self) -> bool:
        """Whether the executor was shut."""
        return bool(self._is_shutdown)


class _WaitList:
    """All that the nodes of an executor wait for; held, so that nothing is freed meanwhile.

    Attributes:
        is_stale: Something was created, destroyed or has to be done: to be made anew.
        beside: Coroutines that wait for something; what their groups hold is not waited for.
    """

    def __init__(self, executor: LeanExecutor, beside: list[Any]) -> None:
        self.is_stale = False
        self.beside = beside
        self._executor = executor
        self._held = ExitStack()
        self._waitables: list[tuple[Any, Callable[[], None]]] = []
        # Kind -> address of the entity that is waited for -> what runs it.
        self._runs: dict[str, dict[int, Callable[[], None]]] = {}
        self._adds: list[tuple[Callable[[Any, Any], Any], Any]] = []
        size = NumberOfEntities()
        wait_set = rclpy_implementation.WaitSet
        adds = {
            "timer": wait_set.add_timer,
            "subscription": wait_set.add_subscription,
            "guard_condition": wait_set.add_guard_condition,
            "client": wait_set.add_client,
            "service": wait_set.add_service,
        }
        context = executor.context.handle
        self._held.enter_context(context)
        found = executor.entities()
        self._own = executor.own_guards()
        found.setdefault("guard_condition", []).extend((guard, _nothing) for guard in self._own)
        for waitable, run in found.pop("waitable", []):
            with suppress(InvalidHandle):
                self._held.enter_context(waitable)
                size += waitable.get_num_entities()
                self._waitables.append((waitable, run))
        for kind, entities in found.items():
            runs = self._runs[kind] = {}
            for entity, run in entities:
                with suppress(InvalidHandle):
                    self._held.enter_context(entity.handle)
                    self._adds.append((adds[kind], entity.handle))
                    runs[entity.handle.pointer] = run
        self._own_pointers = {guard.handle.pointer for guard in self._own}
        self._set = wait_set(
            size.num_subscriptions + len(self._runs.get("subscription", ())),
            size.num_guard_conditions + len(self._runs["guard_condition"]),
            size.num_timers + len(self._runs.get("timer", ())),
            size.num_clients + len(self._runs.get("client", ())),
            size.num_services + len(self._runs.get("service", ())),
            size.num_events,
            context,
        )

    def wait(self) -> list[Callable[[], None]]:
        """Waits until something is ready; returns what runs it.

        Raises:
            ExternalShutdownException: The context was shut.
        """
        ready_set = self._set
        ready_set.clear_entities()
        for add, handle in self._adds:
            add(ready_set, handle)
        try:
            for waitable, _ in self._waitables:
                waitable.add_to_wait_set(ready_set)
        except InvalidHandle:
            # The events of what was destroyed since this list was made.
            self.is_stale = True
            return []
        # Shut before this list was made, it has no guard that would wake it.
        if not self._executor.is_shut:
            ready_set.wait(_FOREVER_NS)
        if self._executor.is_shut:
            return []
        if not self._executor.context.ok():
            raise ExternalShutdownException
        found = [run for waitable, run in self._waitables if waitable.is_ready(ready_set)]
        for kind, runs in self._runs.items():
            for pointer in ready_set.get_ready_entities(kind):
                self.is_stale |= pointer in self._own_pointers
                # Those of waitables are asked above.
                if pointer in runs:
                    found.append(runs[pointer])
        return found

    def close(self) -> None:
        """Lets go of what was waited for."""
        self._held.close()


def _finish(task: Any) -> None:
    """Runs a task as far as it goes; its error ends the executor, as in rclpy's own."""
    if _is_over(task):
        return
    task()
    if task.done() and task.exception() is not None:
        raise task.exception()


def _is_over(task: Any) -> bool:
    return bool(task.done() or task.cancelled())


def _nothing() -> None:
    pass


def _direct(take: Callable[[Any], Callable[[], Any] | None], entity: Any) -> Callable[[], None]:
    """Returns what runs an entity whose callback is no coroutine, without a task around it."""

    def run() -> None:
        if not entity.callback_group.beginning_execution(entity):
            return
        try:
            call = None
            # Destroyed by another callback of the same wake, it is not run.
            with suppress(InvalidHandle), entity.handle:
                call = take(entity)
            if call is not None:
                call()
        finally:
            entity.callback_group.ending_execution(entity)

    return run


def _due(timer: Any) -> Callable[[], Any] | None:
    # A timer that was cancelled meanwhile is still in the list of those ready.
    if not timer.handle.is_timer_ready():
        return None
    timer.handle.call_timer()
    return timer.callback  # type: ignore[no-any-return]


def _received(subscription: Any) -> Callable[[], Any] | None:
    taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    if taken is None:
        return None
    message_only = subscription._callback_type is _MESSAGE_ONLY
    return partial(subscription.callback, *(taken[:1] if message_only else taken))
