"""What a node receives: stock subscriptions whose callbacks store, and an inbox that the stepping thread empties.

An executor of Jazzy looks at each service, timer and event of its node before and after each message, which takes
290 µs of a core: 29 % at 1 kHz. While the system's time is followed, an inbox therefore takes what waits on its
subscriptions itself, by `take_message`, as rclpy's own `wait_for_message` does: 54 µs where all that waits is taken
every 10 ms. Under simulated time, where no message may overtake the /clock before it, and with an rclpy that has no
such call, the executor calls back as usual. This is the only module that uses `take_message`.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.realtime import Arrival
from valve_sim.nodes.spinning import every, guarded, log_left_out

MOST_STORED: Final = 100_000
"""Messages that are kept between two deliveries; of more the oldest are dropped."""

_BETWEEN_LOOKS: Final = 1.0
"""s from one look for publishers that cannot be heard to the next."""

Take = Callable[[Any, Arrival], None]
"""A callback that takes a message and the time at which it was received."""


class Source:
    """One topic that an inbox receives; `take` is called for each message, in the thread that empties the inbox.

    Attributes:
        known_types: of its publishers, which were warned of where they are not its own.
        incompatible_publishers: how many offer less than this topic is subscribed with, such as best effort.
    """

    def __init__(self, topic: str, message_type: type, take: Take) -> None:
        self.topic, self.take = topic, take
        self.type = f"{message_type.__module__.partition('.')[0]}/msg/{message_type.__name__}"
        self.known_types = {self.type}
        self.subscription: Subscription
        self.incompatible_publishers = 0


class Inbox:
    """The topics that a node receives."""

    def __init__(self, node: Node, clock: NodeClock) -> None:
        self._node, self._clock = node, clock
        self._group = _PolledGroup(lambda: self.is_polled)
        self._can_take = True
        self._sources: tuple[Source, ...] = ()
        self._stored: deque[tuple[Source, Any, Arrival]] = deque(maxlen=MOST_STORED)
        self._delivering = threading.Lock()
        clock.when_exchanged(self._wake_executor)
        every(node, _BETWEEN_LOOKS, self._look)

    @property
    def is_polled(self) -> bool:
        """Whether the inbox takes the messages itself, in place of the executor."""
        return self._can_take and not self._clock.is_simulated

    def subscribe(self, message_type: type, topic: str, take: Take, qos: QoSProfile) -> Source:
        """Receive a topic, whose name may be relative to the node; `deliver` calls `take` for each message."""
        source = Source(self._node.resolve_topic_name(topic), message_type, take)

        def store(message: Any, info: Any) -> None:
            self._stored.append((source, message, self._arrival(info)))

        callback: Any = guarded(store)  # its second argument, message info, is missing in rclpy's types
        # Without events: an executor that waits for those alone is woken, again and again, by messages too.
        source.subscription = self._node.create_subscription(
            message_type, topic, callback, qos, callback_group=self._group, event_callbacks=_no_events()
        )
        self._sources += (source,)
        return source

    def unsubscribe(self, source: Source) -> None:
        """Receive a topic no longer, if it still was; to be called by the thread that empties the inbox."""
        if source in self._sources:
            self._sources = tuple(other for other in self._sources if other is not source)
            self._node.destroy_subscription(source.subscription)

    def deliver(self) -> bool:
        """Have each message that has come taken; whether there were any.

        Those that the executor has stored are in the order in which they came. Of those that are polled, the topics
        that were subscribed to first are delivered first, with whatever came before the last message of a later topic.
        """
        with self._delivering:
            self.store_waiting()
            count = len(self._stored)
            for _ in range(count):
                source, message, arrival = self._stored.popleft()
                if source in self._sources:
                    source.take(message, arrival)
        return count > 0

    def forget(self) -> None:
        """Drop all messages that have come."""
        with self._delivering:
            self.store_waiting()
            self._stored.clear()

    def store_waiting(self) -> None:
        """Have what waits in the middleware, which holds as many as the topic's depth, wait here for a delivery."""
        if not self.is_polled:
            return
        waiting = [(source, found) for source in reversed(self._sources) if (found := self._take_waiting(source))]
        for source, found in reversed(waiting):
            self._stored += [(source, *one) for one in found]

    def _take_waiting(self, source: Source) -> list[tuple[Any, Arrival]]:
        subscription = source.subscription
        handle: Any = subscription.handle
        found: list[tuple[Any, Arrival]] = []
        try:
            # No more than can have waited: where messages come as fast as they are taken, this would not end.
            for _ in range(subscription.qos_profile.depth):
                waiting = handle.take_message(subscription.msg_type, False)
                if waiting is None:
                    break
                found.append((waiting[0], self._arrival(waiting[1])))
        except (AttributeError, TypeError):
            self._can_take = False  # this rclpy has another way; the executor's is the same in all
            self._wake_executor()
        except Exception as error:  # of rclpy, which refuses a message; at its end it has no subscription any more
            if self._node.context.ok():
                log_left_out(self._node, error)
        return found

    def _arrival(self, info: Any) -> Arrival:
        return Arrival(int(info.get("received_timestamp", 0)) if isinstance(info, dict) else 0, self._clock.read())

    def _look(self) -> None:
        """Look for publishers that cannot be heard, and warn of them."""
        for source in self._sources:
            found = self._node.get_publishers_info_by_topic(source.topic)
            for other in {entry.topic_type for entry in found} - source.known_types:
                source.known_types.add(other)
                self._node.get_logger().warning(
                    f"{source.topic}: a publisher sends {other} and cannot be heard; publish {source.type}"
                )
            before = source.incompatible_publishers
            lacking = [_lacking(entry.qos_profile, source.subscription.qos_profile) for entry in found]
            source.incompatible_publishers = sum(map(bool, lacking))
            if source.incompatible_publishers > before:
                wanted = next(filter(None, reversed(lacking)))
                self._node.get_logger().warning(
                    f"{source.topic}: a publisher offers an incompatible QoS ({wanted.policy}) and cannot be heard; "
                    f"publish {wanted.words}, as this topic asks"
                )

    def _wake_executor(self) -> None:
        """Have the executor look again at what it waits for."""
        if self._node.executor is not None:
            self._node.executor.wake()


class _Wanted(NamedTuple):
    """What a publisher lacks: the policy of QoS, and what to publish."""

    policy: str
    words: str


def _lacking(offered: QoSProfile, wanted: QoSProfile) -> _Wanted | None:
    """What keeps a publisher from being heard; None for nothing."""
    if (offered.reliability, wanted.reliability) == (ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE):
        return _Wanted("RELIABILITY", "reliable")
    if (offered.durability, wanted.durability) == (DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL):
        return _Wanted("DURABILITY", "transient local")
    return None


def _no_events() -> SubscriptionEventCallbacks:
    return SubscriptionEventCallbacks(use_default_callbacks=False)


class _PolledGroup(CallbackGroup):
    """The group of subscriptions that no executor serves while they are polled."""

    def __init__(self, is_polled: Callable[[], bool]) -> None:
        super().__init__()
        self._is_polled = is_polled

    def can_execute(self, entity: object) -> bool:
        """Whether an executor may wait for it."""
        return not self._is_polled()

    def beginning_execution(self, entity: object) -> bool:
        """Whether an executor may call back now."""
        return self.can_execute(entity)

    def ending_execution(self, entity: object) -> None:
        """Nothing waits for the end of a callback."""
