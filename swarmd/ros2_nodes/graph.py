"""The ROS graph of one robot: topics, timers and services of its nodes, on a time handed in.

All callbacks run one after another, in an order that follows from the nodes alone: messages in the
order in which they were published, timers in the order in which they are due.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, NoReturn

from swarmd.core.errors import PluginError, SwarmError
from swarmd.kit.mistakes import MAX_TEXT, place_of
from swarmd.ros2_nodes.message_classes import Message, MessageClasses
from swarmd.ros2_nodes.qos import QoSProfile
from swarmd.ros2_nodes.refusal import Ended, Interrupted, NotCarriedOver, Spun, one_line
from swarmd.ros2_nodes.ros_time import S_TO_NS

MAX_CALLBACKS = 2_000
"""Callbacks in one step. A node beyond it floods itself or another one."""
MAX_LATE = 500_000_000
"""ns: a timer that is later by more leaves calls out, as after a suspended process."""
MAX_ASKED = 1_000
"""How often one callback may ask `rclpy.ok()`, or for a service that is not there."""
MAX_SUBSCRIPTIONS = 1_000
"""Publishers, subscriptions, timers and services of a robot."""


class Published(NamedTuple):
    """A message that left its node."""

    topic: str
    message: Message
    at: float


@dataclass(eq=False)
class Owner:
    """The node, or the entry of the launch file, to which a callback belongs."""

    name: str
    is_alive: bool = True


@dataclass(eq=False)
class Subscription:
    """A subscription of a node; `pending`: the messages that wait for its callback."""

    owner: Owner
    topic: str
    msg_type: type[Message]
    callback: Callable[..., Any]
    profile: QoSProfile
    callback_group: Any = None
    is_alive: bool = True
    pending: deque[Message] = field(init=False)

    def __post_init__(self) -> None:
        self.pending = deque(maxlen=self.profile.kept)

    @property
    def topic_name(self) -> str:
        """The resolved name of the topic."""
        return self.topic

    def destroy(self) -> None:
        """Get no more messages."""
        self.is_alive = False
        self.pending.clear()


@dataclass(eq=False)
class Publisher:
    """A publisher of a node; `kept`: the last messages, for later subscriptions."""

    graph: Graph
    owner: Owner
    topic: str
    msg_type: type[Message]
    profile: QoSProfile
    is_alive: bool = True
    kept: deque[Message] = field(init=False)

    def __post_init__(self) -> None:
        self.kept = deque(maxlen=self.profile.kept)

    @property
    def topic_name(self) -> str:
        """The resolved name of the topic."""
        return self.topic

    def publish(self, msg: Message) -> None:
        """Give a copy of the message to all subscriptions of the topic."""
        if not isinstance(msg, self.msg_type):
            raise TypeError(
                f"Expected {self.msg_type.TYPE}, got {getattr(msg, 'TYPE', type(msg).__name__)}"
                f" on {self.topic}"
            )
        if self.is_alive:
            self.graph.publish(self, msg)

    def get_subscription_count(self) -> int:
        """How many subscriptions of this robot the topic has."""
        return len(self.graph.subscriptions_of(self.topic))

    def assert_liveliness(self) -> None:
        """Without effect."""

    def wait_for_all_acked(self, timeout: Any = None) -> bool:
        """True: within a robot every message arrives."""
        return True

    def destroy(self) -> None:
        """Publish no more."""
        self.is_alive = False


@dataclass(eq=False)
class Timer:
    """A timer of a node; times in ns, so that a sum of periods has no rounding."""

    graph: Graph
    owner: Owner
    timer_period_ns: int
    callback: Callable[[], Any] | None
    due: int
    called: int
    is_cancelled: bool = False

    def cancel(self) -> None:
        """Call no more, until a reset."""
        self.is_cancelled = True

    def reset(self) -> None:
        """Begin a whole period now."""
        self.is_cancelled = False
        self.due = self.graph.now_ns + self.timer_period_ns

    def is_canceled(self) -> bool:
        """Whether the timer is cancelled."""
        return self.is_cancelled

    def is_ready(self) -> bool:
        """Whether the timer is due."""
        return not self.is_cancelled and self.due <= self.graph.now_ns

    def time_since_last_call(self) -> int:
        """ns since the last call."""
        return self.graph.now_ns - self.called

    def time_until_next_call(self) -> int:
        """ns until the next call."""
        return self.due - self.graph.now_ns

    def destroy(self) -> None:
        """Call no more."""
        self.is_cancelled = True
        self.graph.timers = [one for one in self.graph.timers if one is not self]


class Future:
    """`rclpy.task.Future`: the answer of a service, or what a node sets itself."""

    def __init__(self, *, executor: Any = None) -> None:
        self._is_done = False
        self._is_cancelled = False
        self._result: Any = None
        self._exception: BaseException | None = None
        self._callbacks: list[Callable[[Any], Any]] = []

    def done(self) -> bool:
        """Whether it has a result, an exception, or is cancelled."""
        return self._is_done or self._is_cancelled

    def cancelled(self) -> bool:
        """Whether it is cancelled."""
        return self._is_cancelled

    def cancel(self) -> None:
        """Give it up."""
        self._is_cancelled = not self._is_done

    def result(self) -> Any:
        """The result; raises the exception that was set."""
        if self._exception is not None:
            raise self._exception
        return self._result

    def exception(self) -> BaseException | None:
        """The exception that was set; None without."""
        return self._exception

    def set_result(self, result: Any) -> None:
        """Set the result, and call the callbacks."""
        self._result = result
        self._finish()

    def set_exception(self, exception: BaseException) -> None:
        """Set an exception, and call the callbacks."""
        self._exception = exception
        self._finish()

    def add_done_callback(self, callback: Callable[[Any], Any]) -> None:
        """Call `callback(future)` when it is done."""
        if self.done():
            callback(self)
        else:
            self._callbacks.append(callback)

    def _finish(self) -> None:
        self._is_done = True
        for callback in self._callbacks:
            callback(self)
        self._callbacks.clear()


@dataclass(eq=False)
class Service:
    """A service of a node."""

    owner: Owner
    srv_name: str
    srv_type: Any
    callback: Callable[[Any, Any], Any]

    def destroy(self) -> None:
        """Answer no more."""
        self.owner = Owner(self.owner.name, is_alive=False)


@dataclass(eq=False)
class Client:
    """A client of a service of the same robot."""

    graph: Graph
    owner: Owner
    srv_name: str
    srv_type: Any

    def service_is_ready(self) -> bool:
        """Whether a node of this robot has the service."""
        return self.graph.service(self.srv_name) is not None

    def wait_for_service(self, timeout_sec: float | None = None) -> bool:
        """Whether a node of this robot has the service; waits for nothing."""
        if self.service_is_ready():
            return True
        self.graph.count_question(
            f"waits for the service {self.srv_name}, which no node before it in `nodes` has"
        )
        return False

    def call_async(self, request: Any) -> Future:
        """A future of the answer, which comes after the present callback."""
        future = Future()
        self.graph.call(self.owner, lambda: future.set_result(self.call(request)))
        return future

    def call(self, request: Any, timeout_sec: float | None = None) -> Any:
        """The answer of the service, at once."""
        service = self.graph.service(self.srv_name)
        if service is None:
            raise NotCarriedOver(f"no node of this robot has the service {self.srv_name}")
        kind = self.srv_type
        answer = service.callback(kind.Request.copied(request), kind.Response())
        if not isinstance(answer, kind.Response):
            raise TypeError(
                f"the callback of the service {self.srv_name} gave a {type(answer).__name__};"
                " return the response"
            )
        return kind.Response.copied(answer)

    def destroy(self) -> None:
        """Without effect."""


class Graph:
    """The topics, timers and services of one robot.

    `now`: s since the nodes began. `on_published` gets each published message.
    """

    def __init__(self, types: MessageClasses, on_published: Callable[[Published], None]) -> None:
        self.types = types
        self.now = 0.0
        self.timers: list[Timer] = []
        self.subscriptions: dict[str, list[Subscription]] = {}
        self.publishers: list[Publisher] = []
        self.is_leaving = False  # a script leaves its `main()`: what it cleans up has no effect
        self.is_down = False  # a node has called `rclpy.shutdown()`
        self.refused = ""  # what a node did that no pattern may, also if it caught the error
        self._services: dict[str, Service] = {}
        self._queue: deque[tuple[Owner, Callable[[], Any]]] = deque()
        self._on_published = on_published
        self._callbacks = 0  # of this step
        self._questions = 0  # of this callback

    @property
    def now_ns(self) -> int:
        """`now` in ns."""
        return round(self.now * S_TO_NS)

    # What nodes make

    def add_subscription(self, subscription: Subscription) -> None:
        """Add a subscription; it gets what latched publishers keep."""
        self._check_count(sum(map(len, self.subscriptions.values())))
        topic = subscription.topic
        self.subscriptions.setdefault(topic, []).append(subscription)
        if subscription.profile.is_latched:
            for publisher in self.publishers:
                if publisher.topic == topic and publisher.is_alive and publisher.profile.is_latched:
                    for message in publisher.kept:
                        self._hand(subscription, message)

    def add_publisher(self, publisher: Publisher) -> None:
        """Add a publisher."""
        self._check_count(len(self.publishers))
        self.publishers.append(publisher)

    def add_timer(
        self, owner: Owner, period: float, callback: Callable[[], Any] | None, *, is_started: bool
    ) -> Timer:
        """Add a timer whose first call is due after a whole period (s)."""
        if not 1e-6 <= period < 1e9:
            raise ValueError(f"a timer has the period {period!r} s; expected 1e-6 or more")
        self._check_count(len(self.timers))
        period_ns = round(period * S_TO_NS)
        now = self.now_ns
        timer = Timer(self, owner, period_ns, callback, now + period_ns, now)
        timer.is_cancelled = not is_started
        self.timers.append(timer)
        return timer

    def add_service(self, service: Service) -> None:
        """Add a service."""
        self._check_count(len(self._services))
        self._services[service.srv_name] = service

    def service(self, name: str) -> Service | None:
        """The service of that name; None without."""
        service = self._services.get(name)
        return service if service is not None and service.owner.is_alive else None

    def subscriptions_of(self, topic: str) -> list[Subscription]:
        """The living subscriptions of a topic."""
        return [
            one for one in self.subscriptions.get(topic, ()) if one.is_alive and one.owner.is_alive
        ]

    def remove(self, owner: Owner) -> None:
        """Take a node off: none of its callbacks is called again."""
        owner.is_alive = False
        self.timers = [timer for timer in self.timers if timer.owner is not owner]
        self.publishers = [one for one in self.publishers if one.owner is not owner]

    # What nodes do

    def publish(self, publisher: Publisher, message: Message) -> None:
        """Hand a message to the subscriptions of its topic, and to the pattern."""
        if self.is_leaving:
            return
        if publisher.profile.is_latched:
            publisher.kept.append(publisher.msg_type.copied(message))
        self.deliver(publisher.topic, message)
        self._on_published(Published(publisher.topic, message, self.now))

    def deliver(self, topic: str, message: Message) -> None:
        """Hand a message to the subscriptions of a topic; TypeError if its type differs."""
        for subscription in self.subscriptions_of(topic):
            self._hand(subscription, message)

    def call(self, owner: Owner, callback: Callable[[], Any]) -> None:
        """Call `callback` after the present one."""
        self._queue.append((owner, callback))

    def count_question(self, text: str) -> None:
        """Refuse a node that asks MAX_ASKED times within one callback, and so never returns."""
        self._questions += 1
        if self._questions > MAX_ASKED:
            self.refuse(f"{text}: a callback never waits; use a timer (`create_timer`)")

    def refuse(self, text: str) -> NoReturn:
        """Raise NotCarriedOver, and keep the text for a node that catches it."""
        text = one_line(text)
        self.refused = self.refused or text
        raise NotCarriedOver(text)

    # The pattern's side

    def begin_step(self) -> None:
        """Begin to count the callbacks of a step."""
        self._callbacks = 0

    def run_timers(self, until: float, *, is_included: bool) -> None:
        """Call the timers that are due before `until`, or also at it, in the order of their times.

        The time of each callback is the time at which its timer is due.
        """
        end = round(until * S_TO_NS) + int(is_included)
        while (timer := self._next_timer(end)) is not None:
            self.now = max(self.now, timer.due / S_TO_NS)
            timer.called = timer.due
            timer.due += timer.timer_period_ns
            if timer.due < end - MAX_LATE:
                # As rcl does after a pause: whole periods are left out, so that the phase stays.
                missed = (end - MAX_LATE - timer.due) // timer.timer_period_ns + 1
                timer.due += missed * timer.timer_period_ns
            if timer.callback is not None:
                self.run(timer.owner, timer.callback)
            self.run_queue()

    def run_queue(self) -> None:
        """Call the callbacks of all messages, and of those that they publish, in their order."""
        while self._queue:
            owner, callback = self._queue.popleft()
            if owner.is_alive:
                self.run(owner, callback)

    def run(self, owner: Owner, callback: Callable[..., Any], *args: Any) -> Any:
        """Call code of a node. PluginError in one line, with node and place, if it raises.

        `Ended` if the node has ended itself.
        """
        self._callbacks += 1
        self._questions = 0
        if self._callbacks > MAX_CALLBACKS:
            raise PluginError(
                f"{owner.name}: more than {MAX_CALLBACKS} callbacks in one step; does a callback"
                " publish on the topic that calls it?"
            )
        was_leaving = self.is_leaving
        try:
            result = callback(*args)
            if hasattr(result, "__await__"):
                result = _finished(result)
        except SystemExit as error:
            raise Ended(f"{owner.name} has ended itself: sys.exit({error.code!r})") from None
        except Interrupted:
            raise Ended(f"{owner.name} has ended itself: KeyboardInterrupt") from None
        except KeyboardInterrupt:  # of the user of this program
            raise
        except Spun:
            self._refuse_spin(owner)
        except NotCarriedOver as error:
            raise PluginError(f"{owner.name}: {one_line(str(error))}") from error
        except (Ended, PluginError, MemoryError):
            raise
        except BaseException as error:  # a node may raise anything
            raise PluginError(f"{owner.name}: {self._refusal_or(error)}") from error
        if self.is_leaving and not was_leaving:  # a bare `except` of the callback has caught Spun
            self._refuse_spin(owner)
        if self.refused:
            raise PluginError(f"{owner.name}: {self.refused}")
        if self.is_down:
            raise Ended(f"{owner.name} has ended itself: rclpy.shutdown()")
        return result

    def _refuse_spin(self, owner: Owner) -> NoReturn:
        self.is_leaving = False
        raise PluginError(
            f"{owner.name}: calls rclpy.spin in a callback; spin once, in main()"
        ) from None

    def _refusal_or(self, error: BaseException) -> str:
        if isinstance(error, SwarmError):
            return one_line(str(error))
        return self.refused or described(error)

    def _next_timer(self, end: int) -> Timer | None:
        """The timer that is due first, and before `end` (ns); of equal ones the one made first."""
        due = [timer for timer in self.timers if not timer.is_cancelled and timer.due < end]
        return min(due, key=lambda timer: timer.due, default=None)

    def _hand(self, subscription: Subscription, message: Message) -> None:
        """Let a message wait for a subscription, as a copy: no two of them share one."""
        if subscription.msg_type.TYPE != message.TYPE:
            raise TypeError(
                f"{subscription.topic} carries {message.TYPE}, and {subscription.owner.name}"
                f" subscribes to it as {subscription.msg_type.TYPE}"
            )
        # Beyond its depth the oldest message is dropped.
        subscription.pending.append(subscription.msg_type.copied(message))

        def take() -> None:
            if subscription.pending and subscription.is_alive:
                subscription.callback(subscription.pending.popleft())

        self._queue.append((subscription.owner, take))
        if len(self._queue) > MAX_CALLBACKS:
            raise PluginError(
                f"more than {MAX_CALLBACKS} messages wait on this robot, the last on"
                f" {subscription.topic}; publish less in one callback"
            )

    def _check_count(self, count: int) -> None:
        if count >= MAX_SUBSCRIPTIONS:
            raise PluginError(
                f"more than {MAX_SUBSCRIPTIONS} publishers, subscriptions or timers on one robot;"
                " make them once, not in a callback"
            )


_REMEDIES: Mapping[str, str] = {
    "only 0-dimensional arrays": "write `one_element_arrays: true` in the launch file, or use"
    " numpy below 2.4",
    "only length-1 arrays": "write `one_element_arrays: true` in the launch file, or use numpy"
    " below 2.4",
}


def described(error: BaseException) -> str:
    """An error of a node in one line, with the place in its code."""
    text = " ".join(str(error).split())[:MAX_TEXT]
    for begin, remedy in _REMEDIES.items():
        if begin in text:
            text = f"{text}; {remedy}"
    place = place_of(error)
    where = "" if place is None else f" ({place.file.rsplit('/', 1)[-1]}:{place.line})"
    return one_line(f"{type(error).__name__}: {text}{where}")


def _finished(coroutine: Any) -> Any:
    """The result of an `async def` callback that awaits nothing but what is done."""
    try:
        coroutine.send(None)
    except StopIteration as stop:
        return stop.value
    coroutine.close()
    raise NotCarriedOver(
        "a callback awaits what is not done yet; use `add_done_callback` on the future"
    )
