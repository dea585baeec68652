"""Messages as ROS 2 puts them on the wire and into files: CDR, with schemas that say how to read it. By rosbags.

rosbags (https://ternaris.gitlab.io/rosbags) knows the definitions of ROS itself, so no ROS is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fovconn_env.errors import MissingPackage, SettingError
from fovconn_env.fleet.ros.definitions import PACKAGE, definitions

SCHEMA_ENCODING, MESSAGE_ENCODING = "ros2msg", "cdr"  # as MCAP and Foxglove call them
_RULE = "=" * 80  # between the definitions of a schema
_Make = Callable[[Any], Any]  # a value as rosbags takes it


class Cdr:
    """Encodes messages of Jazzy, the ROS 2 of 2024 to 2029, and of `fovconn_msgs`."""

    def __init__(self, needed_by: str = "cdr", extra: str = "mcap") -> None:
        """Raises `MissingPackage`, which names this extra, without rosbags."""
        try:
            from rosbags.typesys import Stores, get_types_from_msg, get_typestore
        except ImportError as problem:
            raise MissingPackage(f'{needed_by} needs rosbags: pip install "fovconn-env[{extra}]"') from problem
        self._store: Any = get_typestore(Stores.ROS2_JAZZY)
        for name, text in definitions().items():
            self._store.register(get_types_from_msg(text, f"{PACKAGE}/msg/{name}"))
        self._makers: dict[str, tuple[type, dict[str, tuple[_Make, Callable[[], Any]]]]] = {}

    def schema(self, kind: str) -> str:
        """The definition of a message and of all that it is made of; those of ours with their comments."""
        text = self._store.generate_msgdef(kind, ros_version=2)[0]
        own = definitions()
        parts = []
        for k, part in enumerate(text.split(f"{_RULE}\n")):
            head, _, rest = part.partition("\n") if k else ("", "", part)
            package, _, name = (head.removeprefix("MSG: ") if k else kind).partition("/")
            body = own[name.removeprefix("msg/")] if package == PACKAGE else rest
            parts.append(f"{head}\n{body}" if k else body)
        return f"{_RULE}\n".join(parts)

    def encode(self, kind: str, content: Mapping[str, Any]) -> bytes:
        """CDR, little-endian, of a message by its fields; what is left out is 0, "", empty.

        Arrays of numbers may be anything that numpy takes. Raises `KeyError` for a field that there is not.
        """
        return bytes(self._store.serialize_cdr(self._made(kind, content), kind, little_endian=True))

    def decode(self, kind: str, data: bytes) -> Any:
        """A message, by attributes, of its CDR; raises `SettingError` for bytes that are none."""
        try:
            return self._store.deserialize_cdr(data, kind)
        except Exception as problem:  # rosbags' generated code meets anything
            raise SettingError(f"a message must be CDR of {kind}, got {len(data)} bytes: {problem!r}") from None

    def type_hash(self, kind: str) -> str:
        """The hash by which ROS 2 tells definitions apart (REP-2016), "RIHS01_..."."""
        return self._store.hash_rihs01(kind)

    def fields(self, kind: str) -> list[tuple[str, Any]]:
        """Name and description, as rosbags has them, of each field of a message."""
        return self._store.fielddefs[kind][1]

    def _made(self, kind: str, content: Mapping[str, Any]) -> Any:
        """A message as rosbags' class."""
        if kind not in self._makers:
            fields = {name: self._field(description) for name, description in self._store.fielddefs[kind][1]}
            self._makers[kind] = self._store.types[kind], fields
        made, fields = self._makers[kind]
        values = {name: default() for name, (_, default) in fields.items() if name not in content}
        return made(**values, **{name: fields[name][0](value) for name, value in content.items()})

    def _field(self, description: Any) -> tuple[_Make, Callable[[], Any]]:
        """How a field is made of a value, and its default."""
        node, about = description[0].name, description[1]
        if node == "BASE":
            make = {"string": str, "bool": bool}.get(about[0], float if about[0].startswith("float") else int)
            return make, make
        if node == "NAME":
            return (lambda content: self._made(about, content)), (lambda: self._made(about, {}))
        (inner_node, inner), count = about
        if inner_node.name == "NAME":
            return (lambda items: [self._made(inner, item) for item in items]), list
        return (lambda numbers: np.asarray(numbers, inner[0])), (lambda: np.zeros(count, inner[0]))
