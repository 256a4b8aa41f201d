"""`rclpy.node.Node` on the graph of one robot."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

from swarmd.ros2_nodes.graph import Client, Graph, Owner, Publisher, Service, Subscription, Timer
from swarmd.ros2_nodes.launch_file import is_for
from swarmd.ros2_nodes.logger import Logger
from swarmd.ros2_nodes.parameters import Parameter, Parameters, ParameterType
from swarmd.ros2_nodes.qos import profile_of
from swarmd.ros2_nodes.refusal import NotCarriedOver
from swarmd.ros2_nodes.ros_time import Clock, Duration, Time


@dataclass(eq=False)
class NodeSetup:
    """What the launch file says of the nodes of one entry.

    `parameters`: (name pattern, values), weakest first. `remap`: from resolved or relative names.
    """

    name: str
    namespace: str
    parameters: list[tuple[str, dict[str, Any]]]
    remap: Mapping[str, str]


@dataclass(eq=False)
class RobotSide:
    """The parts of one robot that its nodes use; `setup`: of the entry that is being started."""

    graph: Graph
    clock: Clock
    time: type[Time]
    duration: type[Duration]
    log: Callable[[str, str, str], None]
    setup: NodeSetup
    nodes: list[Node] = field(default_factory=list)


class Node:
    """A node; each robot has a class of its own, whose `_robot_side` is the robot.

    Its own names are mangled, as those of rclpy: a node may call its attributes `_name` or `side`.
    """

    _robot_side: ClassVar[RobotSide]

    def __init__(
        self,
        node_name: str,
        *,
        context: Any = None,
        cli_args: Any = None,
        namespace: str | None = None,
        use_global_arguments: bool = True,
        enable_rosout: bool = True,
        start_parameter_services: bool = True,
        parameter_overrides: Iterable[Parameter] | None = None,
        allow_undeclared_parameters: bool = False,
        automatically_declare_parameters_from_overrides: bool = False,
        **_: Any,
    ) -> None:
        """Options that have no counterpart here, such as `enable_rosout`, have no effect."""
        setup = self._robot_side.setup
        self.__name = setup.name or node_name
        given = namespace or ""
        self.__namespace = setup.namespace if not given.startswith("/") else given
        if given and not given.startswith("/"):
            self.__namespace = f"{setup.namespace.rstrip('/')}/{given}"
        self.__remap = {
            self.__resolved(old): self.__resolved(new) for old, new in setup.remap.items()
        }
        self.__owner = Owner(self.__name)
        values = {one.name: one.value for one in parameter_overrides or ()}
        for pattern, content in setup.parameters:
            if is_for(pattern, self.get_fully_qualified_name()):
                values |= content
        self.__parameters = Parameters(values, self.__result, open_=allow_undeclared_parameters)
        self.__logger = Logger(self.__name, self._robot_side.log, self._robot_side.clock)
        self.executor: Any = None
        self.context: Any = context
        self.default_callback_group: Any = None
        self.__publishers: list[Publisher] = []
        self.__subscriptions: list[Subscription] = []
        self.__timers: list[Timer] = []
        self.__services: list[Service] = []
        self.__clients: list[Client] = []
        self._robot_side.nodes.append(self)
        self.declare_parameter("use_sim_time", False)
        if automatically_declare_parameters_from_overrides:
            for name, value in values.items():
                if not self.has_parameter(name):
                    self.declare_parameter(name, value)

    # Names

    def get_name(self) -> str:
        """The node's name."""
        return self.__name

    def get_namespace(self) -> str:
        """The node's namespace, which begins with a slash."""
        return self.__namespace

    def get_fully_qualified_name(self) -> str:
        """Namespace and name."""
        return f"{self.__namespace.rstrip('/')}/{self.__name}"

    def resolve_topic_name(self, topic: str, *, only_expand: bool = False) -> str:
        """The full name of a topic, after remapping."""
        full = self.__resolved(topic)
        return full if only_expand else self.__remap.get(full, full)

    def resolve_service_name(self, service: str, *, only_expand: bool = False) -> str:
        """The full name of a service, after remapping."""
        return self.resolve_topic_name(service, only_expand=only_expand)

    def __resolved(self, name: str) -> str:
        if name.startswith("~"):
            return f"{self.get_fully_qualified_name()}/{name[1:].lstrip('/')}"
        if name.startswith("/"):
            return name
        return f"{self.__namespace.rstrip('/')}/{name}"

    # What a node makes

    def create_publisher(
        self, msg_type: Any, topic: str, qos_profile: Any = 10, **_: Any
    ) -> Publisher:
        """Publish messages of a type on a topic."""
        publisher = Publisher(
            self._robot_side.graph,
            self.__owner,
            self.resolve_topic_name(topic),
            self.__message_type(msg_type, topic),
            profile_of(qos_profile),
        )
        self._robot_side.graph.add_publisher(publisher)
        self.__publishers.append(publisher)
        return publisher

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[[Any], Any],
        qos_profile: Any = 10,
        *,
        callback_group: Any = None,
        **_: Any,
    ) -> Subscription:
        """Call `callback` with each message of a topic."""
        subscription = Subscription(
            self.__owner,
            self.resolve_topic_name(topic),
            self.__message_type(msg_type, topic),
            callback,
            profile_of(qos_profile),
            callback_group,
        )
        self._robot_side.graph.add_subscription(subscription)
        self.__subscriptions.append(subscription)
        return subscription

    def create_timer(
        self,
        timer_period_sec: float,
        callback: Callable[[], Any] | None,
        callback_group: Any = None,
        clock: Any = None,
        autostart: bool = True,
    ) -> Timer:
        """Call `callback` every `timer_period_sec` s, first after a whole period."""
        timer = self._robot_side.graph.add_timer(
            self.__owner, float(timer_period_sec), callback, is_started=autostart
        )
        self.__timers.append(timer)
        return timer

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[[Any, Any], Any], **_: Any
    ) -> Service:
        """Answer requests of the nodes of this robot."""
        service = Service(self.__owner, self.resolve_service_name(srv_name), srv_type, callback)
        self._robot_side.graph.add_service(service)
        self.__services.append(service)
        return service

    def create_client(self, srv_type: Any, srv_name: str, **_: Any) -> Client:
        """A client of a service of this robot."""
        name = self.resolve_service_name(srv_name)
        client = Client(self._robot_side.graph, self.__owner, name, srv_type)
        self.__clients.append(client)
        return client

    def create_rate(self, frequency: float, clock: Any = None) -> Any:
        """Refused: a callback never waits."""
        self._robot_side.graph.refuse(
            "create_rate: a node never waits in a pattern; use a timer (`create_timer`)"
        )

    def create_guard_condition(self, callback: Callable[[], Any], **_: Any) -> Any:
        """Refused: nothing outside of the robot's nodes triggers them."""
        self._robot_side.graph.refuse("create_guard_condition: use a topic or a timer")

    def __message_type(self, msg_type: Any, topic: str) -> Any:
        if not hasattr(msg_type, "FIELDS"):
            raise TypeError(
                f"{topic}: {msg_type!r} is no message type, such as geometry_msgs.msg.Twist"
            )
        return msg_type

    # What a node has

    @property
    def publishers(self) -> list[Publisher]:
        """Its publishers."""
        return self.__publishers

    @property
    def subscriptions(self) -> list[Subscription]:
        """Its subscriptions."""
        return self.__subscriptions

    @property
    def timers(self) -> list[Timer]:
        """Its timers."""
        return self.__timers

    @property
    def services(self) -> list[Service]:
        """Its services."""
        return self.__services

    @property
    def clients(self) -> list[Client]:
        """Its clients."""
        return self.__clients

    def get_logger(self) -> Logger:
        """The logger, whose lines are in the robot's log."""
        return self.__logger

    def get_clock(self) -> Clock:
        """The clock, which shows the time since the nodes began."""
        return self._robot_side.clock

    def count_publishers(self, topic_name: str) -> int:
        """The publishers of a topic on this robot."""
        name = self.resolve_topic_name(topic_name)
        return sum(1 for one in self._robot_side.graph.publishers if one.topic == name)

    def count_subscribers(self, topic_name: str) -> int:
        """The subscriptions of a topic on this robot."""
        return len(self._robot_side.graph.subscriptions_of(self.resolve_topic_name(topic_name)))

    def get_topic_names_and_types(self, no_demangle: bool = False) -> list[tuple[str, list[str]]]:
        """The topics of this robot with their types."""
        types = {one.topic: one.msg_type.TYPE for one in self._robot_side.graph.publishers}
        for topic, subscriptions in self._robot_side.graph.subscriptions.items():
            if subscriptions:
                types[topic] = subscriptions[-1].msg_type.TYPE
        return [(topic, [kind]) for topic, kind in sorted(types.items())]

    def get_node_names(self) -> list[str]:
        """The names of the nodes of this robot."""
        return [node.get_name() for node in self._robot_side.nodes]

    # Parameters

    def declare_parameter(
        self, name: str, value: Any = None, descriptor: Any = None, ignore_override: bool = False
    ) -> Parameter:
        """Declare a parameter; the launch file's value comes before `value`."""
        return self.__parameters.declare(name, value, descriptor, ignore_override=ignore_override)

    def declare_parameters(
        self, namespace: str, parameters: Iterable[tuple[Any, ...]], ignore_override: bool = False
    ) -> list[Parameter]:
        """Declare several parameters: (name), (name, value) or (name, value, descriptor)."""
        declared = []
        for one in parameters:
            name, value, descriptor = (*one, None, None)[:3]
            full = f"{namespace}.{name}" if namespace else name
            declared.append(self.declare_parameter(full, value, descriptor, ignore_override))
        return declared

    def undeclare_parameter(self, name: str) -> None:
        """Forget a parameter."""
        self.__parameters.undeclare(name)

    def has_parameter(self, name: str) -> bool:
        """Whether a parameter is declared."""
        return self.__parameters.has(name)

    def get_parameter(self, name: str) -> Parameter:
        """A declared parameter."""
        return self.__parameters.get(name)

    def get_parameters(self, names: Iterable[str]) -> list[Parameter]:
        """Several declared parameters."""
        return [self.__parameters.get(name) for name in names]

    def get_parameter_or(self, name: str, alternative_value: Parameter | None = None) -> Parameter:
        """A parameter, or the alternative if it is not declared."""
        if self.__parameters.has(name):
            return self.__parameters.get(name)
        return alternative_value or Parameter(name, ParameterType.NOT_SET)

    def get_parameters_by_prefix(self, prefix: str) -> dict[str, Parameter]:
        """The parameters below a prefix, by the rest of their names."""
        names = self.__parameters.names(prefix)
        start = f"{prefix}." if prefix else ""
        return {name.removeprefix(start): self.__parameters.get(name) for name in names}

    def get_parameter_type(self, name: str) -> ParameterType:
        """The type of a parameter."""
        return self.__parameters.get(name).type_

    def set_parameters(self, parameter_list: list[Parameter]) -> list[Any]:
        """Set parameters one after another."""
        return self.__parameters.set(parameter_list)

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> Any:
        """Set all parameters or none."""
        return self.__parameters.set_together(list(parameter_list))

    def add_on_set_parameters_callback(self, callback: Callable[[list[Parameter]], Any]) -> None:
        """Ask `callback` before each change."""
        self.__parameters.callbacks.insert(0, callback)

    def remove_on_set_parameters_callback(self, callback: Callable[[list[Parameter]], Any]) -> None:
        """Ask it no more."""
        self.__parameters.callbacks.remove(callback)

    def add_post_set_parameters_callback(self, callback: Callable[[list[Parameter]], Any]) -> None:
        """Call `callback` after each change."""
        self.__parameters.after.append(callback)

    def describe_parameter(self, name: str) -> Any:
        """The descriptor of a parameter."""
        return self.__parameters.descriptor(name)

    def __result(self, is_successful: bool, reason: str) -> Any:
        result: Any = self._robot_side.graph.types.kind("rcl_interfaces/msg/SetParametersResult")()
        result.successful = is_successful
        result.reason = reason
        return result

    # The end

    def destroy_node(self) -> bool:
        """Take the node off; without effect while a script leaves its `main()`."""
        if not self._robot_side.graph.is_leaving:
            self._robot_side.graph.remove(self.__owner)
            self._robot_side.nodes[:] = [
                node for node in self._robot_side.nodes if node is not self
            ]
        return True

    def __enter__(self) -> Self:
        """Begin a block at whose end the node is taken off."""
        return self

    def __exit__(self, *_: object) -> None:
        self.destroy_node()

    def destroy_publisher(self, publisher: Publisher) -> bool:
        """Publish no more."""
        publisher.destroy()
        return True

    def destroy_subscription(self, subscription: Subscription) -> bool:
        """Get no more messages."""
        subscription.destroy()
        return True

    def destroy_timer(self, timer: Timer) -> bool:
        """Call no more."""
        timer.destroy()
        return True

    def destroy_service(self, service: Service) -> bool:
        """Answer no more."""
        service.destroy()
        return True

    def destroy_client(self, client: Client) -> bool:
        """Without effect."""
        return True

    def __getattr__(self, name: str) -> Any:
        """An attribute that neither the node nor this class has."""
        if name.startswith(("create_", "get_", "set_")) and name in _LEFT_OUT:
            raise NotCarriedOver(f"Node.{name}: {_LEFT_OUT[name]}")
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")


_LEFT_OUT: Mapping[str, str] = {
    "get_publishers_info_by_topic": "use `count_publishers`",
    "get_subscriptions_info_by_topic": "use `count_subscribers`",
    "set_descriptor": "give the descriptor to `declare_parameter`",
}
