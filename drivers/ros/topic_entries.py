"""The table of the options with entries: how an entry is read, and how values are collected."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from swarmd.drivers.ros.message_types import MessageTypes
from swarmd.drivers.ros.topic_detections import Detections, topic_detections
from swarmd.drivers.ros.topic_hazards import Hazards, topic_hazard
from swarmd.drivers.ros.topic_inputs import TopicEntry, TopicInputs
from swarmd.drivers.ros.topic_readings import Readings, topic_readings

FullName = Callable[[str], str]


class EntryKind(NamedTuple):
    """An option with entries, such as `readings`: the functions that read and collect them.

    `read(name, options, full_name, types)` makes the readers of the item `name` of the option: an
    item of `readings` may have several sensors, each with a reader; any other item has one reader.
    ConfigError names the key that is wrong. `inputs(entries)` makes the object that collects the
    values of all readers.
    """

    read: Callable[[str, Any, FullName, MessageTypes], tuple[TopicEntry, ...]]
    inputs: Callable[[Mapping[str, Any]], TopicInputs[Any, Any]]


ENTRY_KINDS: Mapping[str, EntryKind] = MappingProxyType(
    {
        "readings": EntryKind(topic_readings, Readings),
        "hazards": EntryKind(topic_hazard, Hazards),
        "detections": EntryKind(topic_detections, Detections),
    }
)
"""By the option, a field of `TopicOptions`."""
