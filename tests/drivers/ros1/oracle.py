"""ROS's own serialisation of messages, under the system's Python: JSON lines in, JSON lines out.

Each has a `type`. With `fields` the answer is `bytes` in hex and the type's `md5sum`; with `bytes`
it is `fields`; with `text`, a definition, its `md5sum`.
"""

from __future__ import annotations

import io
import json
import sys
from typing import Any

import genpy
import genpy.dynamic
import roslib.message


def answer(order: dict[str, Any]) -> dict[str, Any]:
    if "text" in order:
        made = genpy.dynamic.generate_dynamic(order["type"], order["text"])
        return {"md5sum": made[order["type"]]._md5sum}
    message = roslib.message.get_message_class(order["type"])()
    if "bytes" in order:
        message.deserialize(bytes.fromhex(order["bytes"]))
        return {"fields": plain(message)}
    fill(message, order["fields"])
    buffer = io.BytesIO()
    message.serialize(buffer)
    return {"bytes": buffer.getvalue().hex(), "md5sum": message._md5sum}


def fill(message: Any, fields: dict[str, Any]) -> None:
    """Set the fields of a message, and of those within."""
    for name, value in fields.items():
        old = getattr(message, name)
        if isinstance(old, genpy.rostime.TVal):
            setattr(message, name, genpy.Time(*value))
        elif isinstance(value, dict):
            fill(old, value)
        else:
            setattr(message, name, value)


def plain(value: Any) -> Any:
    if isinstance(value, genpy.rostime.TVal):
        return [value.secs, value.nsecs]
    if isinstance(value, genpy.Message):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    return value


if __name__ == "__main__":
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), flush=True)
