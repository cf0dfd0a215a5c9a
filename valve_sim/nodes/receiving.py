"""A thread of its own for the messages of one subscription, for which rclpy's executor takes too long."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from rclpy.callback_groups import CallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription

from valve_sim.nodes.spinning import CallbackError, log_left_out, waiting_messages
from valve_sim.nodes.stoppable import StoppableThread

_WITHOUT_END: Final = -1


class LeftToReceiver(CallbackGroup):
    """The group of a subscription that no executor serves, because a `Receiver` does."""

    def can_execute(self, entity: object) -> bool:
        """Whether an executor may wait for it."""
        return False

    def beginning_execution(self, entity: object) -> bool:
        """Whether an executor may call back now."""
        return False

    def ending_execution(self, entity: object) -> None:
        """Nothing waits for the end of a callback."""


class Receiver(StoppableThread):
    """Waits for the messages and events of one subscription, whose group is `LeftToReceiver`, and calls back with each.

    An executor looks at each service, timer and event of its node before and after each message, twice 0.4 ms of CPU
    time, and the message gets older meanwhile. Here nothing else is waited for, in the manner of rclpy's own
    `wait_for_message`.

    Args:
        node: of the subscription.
        subscription: its callbacks, which are `guarded`, are called in this thread.
        fail: called with what went wrong, if a callback did; the thread then ends.
    """

    def __init__(self, node: Node, subscription: Subscription, fail: Callable[[Exception], None]) -> None:
        super().__init__("receiver")
        self._node, self._subscription, self._fail = node, subscription, fail
        # Events are waited for beside messages: alone they would be woken, again and again, by messages too.
        handlers: Any = subscription.event_handlers
        self._events: list[Any] = list(handlers)
        self._end = node.create_guard_condition(lambda: None, callback_group=subscription.callback_group)

    def wake(self) -> None:
        """Interrupt the wait for a message."""
        self._end.trigger()

    def run(self) -> None:
        """The thread."""
        context: Any = self._node.context
        with context.handle, self._subscription.handle, self._end.handle:
            waiting: Any = rclpy_implementation.WaitSet(1, 1, 0, 0, 0, len(self._events), context.handle)
            while not self.is_stopping and context.ok():
                try:
                    self._wait(waiting)
                    self._take_all(waiting)
                except CallbackError as error:
                    self._fail(error)
                    return
                except Exception as error:
                    if context.ok():
                        log_left_out(self._node, error)

    def _wait(self, waiting: Any) -> None:
        waiting.clear_entities()
        waiting.add_subscription(self._subscription.handle)
        waiting.add_guard_condition(self._end.handle)
        for event in self._events:
            event.add_to_wait_set(waiting)
        waiting.wait(_WITHOUT_END)

    def _take_all(self, waiting: Any) -> None:
        for message, _ in waiting_messages(self._subscription):
            if self.is_stopping:
                return
            self._subscription.callback(message)
        for event in self._events:
            if event.is_ready(waiting):
                event.callback(event.take_data())
