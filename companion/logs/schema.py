"""Which message lives on which log topic, and its JSON schema in the dialect that viewers read.

Foxglove's parser for MCAP JSON schemas (open-source version: foxglove/studio, packages/mcap-support,
parseJsonSchema.ts) wants `type: object` at the root, a plain `type` on every property, no `$ref`, no `anyOf`,
`properties` on every object, and no arrays of arrays. `viewer_schema` turns msgspec's schema into that
dialect. The data itself is untouched: arrays of arrays (PlanResult.x) are in the message but not in its
schema, and a property that may be null says so in its description.
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from companion.core.messages import INPUTS, NOTES, OUTPUTS, Message, topic

RAW_PREFIX = "/raw/"
VIEWER_PREFIX = "/foxglove/"
METADATA_NAME = "aritra"
GOES_ON_NAME = "aritra/goes on"
"""Metadata at the end of a file of a log that has another one after it."""

KINDS: dict[str, type[Message]] = {topic(kind): kind for kind in (*INPUTS, *OUTPUTS, *NOTES)}


class RawBytes(Message, frozen=True, kw_only=True):
    """Bytes of one read from (`rx`) or one write to (`tx`) a link; base64 in the log's JSON."""

    link: str
    direction: Literal["rx", "tx"]
    data: bytes


def flow(kind: type[Message]) -> str:
    """Role of a message class: input | output | note | raw."""
    if kind in INPUTS:
        return "input"
    if kind in OUTPUTS:
        return "output"
    return "raw" if kind is RawBytes else "note"


def viewer_schema(kind: type[msgspec.Struct], name: str) -> bytes:
    """JSON schema of `kind`, titled `name`, in the dialect above."""
    (root,), definitions = msgspec.json.schema_components([kind])
    schema = _plain(root, definitions)
    return msgspec.json.encode({**schema, "title": name})


def _plain(node: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    if "$ref" in node:
        return _plain(definitions[node["$ref"].rsplit("/", 1)[1]], definitions)
    if "anyOf" in node:
        (some,) = (option for option in node["anyOf"] if option != {"type": "null"})
        return {**_plain(some, definitions), "description": "null where unknown"}
    if "enum" in node:
        return {"type": "string", **node}
    if node["type"] == "array":
        of = node.get("prefixItems", [node["items"]])[0]  # a tuple's are all alike, wherever a message has one
        kept = {key: value for key, value in node.items() if key != "prefixItems"}
        return {**kept, "items": _plain(of, definitions)}
    if node["type"] == "object":
        fields = {key: _plain(value, definitions) for key, value in node.get("properties", {}).items()}
        return {**node, "properties": {key: value for key, value in fields.items() if not _nested(value)}}
    return node


def _nested(node: dict[str, Any]) -> bool:
    return node["type"] == "array" and node["items"]["type"] == "array"
