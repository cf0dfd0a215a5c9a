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


class ReceiverGroup(CallbackGroup):
    """The group of a subscription that no executor serves until its `Receiver` has ended."""

    def __init__(self) -> None:
        super().__init__()
        self.is_left_to_executor = False

    def can_execute(self, entity: object) -> bool:
        """Whether an executor may wait for it."""
        return self.is_left_to_executor

    def beginning_execution(self, entity: object) -> bool:
        """Whether an executor may call back now."""
        return self.is_left_to_executor

    def ending_execution(self, entity: object) -> None:
        """Nothing waits for the end of a callback."""


class Receiver(StoppableThread):
    """Waits for the messages and events of one subscription, and calls back with each, for as long as it is allowed to.

    An executor looks at each service, timer and event of its node before and after each message, twice 0.4 ms of CPU
    time, and the message gets older meanwhile. Here nothing else is waited for, in the manner of rclpy's own
    `wait_for_message`. What other subscriptions hear may be overtaken: where their order counts, this must not serve.

    Args:
        node: of the subscription.
        subscription: its callbacks, which are `guarded`, are called in this thread; its group is a `ReceiverGroup`.
        may_serve: whether this may go on; if not, the node's executor serves the subscription from then on. To be
            followed by `wake` where it changes.
        fail: called with what went wrong, if a callback did; the thread then ends.
    """

    def __init__(
        self,
        node: Node,
        subscription: Subscription,
        may_serve: Callable[[], bool],
        fail: Callable[[Exception], None],
    ) -> None:
        super().__init__("receiver")
        self._node, self._subscription, self._may_serve, self._fail = node, subscription, may_serve, fail
        # Events are waited for beside messages: alone they would be woken, again and again, by messages too.
        handlers: Any = subscription.event_handlers
        self._events: list[Any] = list(handlers)
        # In a group of its own, which no executor ever serves.
        self._woken: Any = node.create_guard_condition(lambda: None, callback_group=ReceiverGroup())

    def wake(self) -> None:
        """Interrupt the wait for a message."""
        self._woken.trigger()

    def run(self) -> None:
        """The thread."""
        context: Any = self._node.context
        with context.handle, self._subscription.handle, self._woken.handle:
            waiting: Any = rclpy_implementation.WaitSet(1, 1, 0, 0, 0, len(self._events), context.handle)
            while not self.is_stopping and self._may_serve() and context.ok():
                try:
                    self._wait(waiting)
                    self._take_all(waiting)
                except CallbackError as error:
                    self._fail(error)
                    return
                except Exception as error:
                    if context.ok():
                        log_left_out(self._node, error)
        if not self.is_stopping and context.ok():
            self._leave_to_executor()

    def _leave_to_executor(self) -> None:
        group: Any = self._subscription.callback_group
        group.is_left_to_executor = True
        if self._node.executor is not None:
            self._node.executor.wake()

    def _wait(self, waiting: Any) -> None:
        waiting.clear_entities()
        waiting.add_subscription(self._subscription.handle)
        waiting.add_guard_condition(self._woken.handle)
        for event in self._events:
            event.add_to_wait_set(waiting)
        waiting.wait(_WITHOUT_END)

    def _take_all(self, waiting: Any) -> None:
        messages = waiting_messages(self._subscription)
        while not self.is_stopping and self._may_serve() and (waiting_message := next(messages, None)) is not None:
            self._subscription.callback(waiting_message[0])
        for event in self._events:
            if event.is_ready(waiting):
                event.callback(event.take_data())
