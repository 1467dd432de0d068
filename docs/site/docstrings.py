"""Docstrings as Sphinx reads them: plain text with `code`, lists, and indented blocks that stay as they are."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

_CODE = re.compile(r"(`+)(.+?)\1")
_SPECIAL = re.compile(r"([*|\\_`])")
_ITEM = re.compile(r"(?:[-*]|\d+\.) +")


def as_restructured_text(lines: Sequence[str]) -> list[str]:
    """Escape what means something, double the backticks, put indented blocks into literal blocks."""
    return [line for block in _blocks(lines) for line in (*_block(block), "")]


def _blocks(lines: Sequence[str]) -> Iterator[list[str]]:
    """Paragraphs, and between them indented blocks as wholes."""
    block: list[str] = []
    for line in lines:
        indented = line.startswith("  ")
        if (
            block
            and (not line.strip() or indented != block[0].startswith("  "))
            and not (indented and _ITEM.match(block[0]))
        ):
            yield block
            block = []
        if line.strip():
            block.append(line.rstrip())
    if block:
        yield block


def _block(block: list[str]) -> Iterator[str]:
    if block[0].startswith("  "):
        yield from ("::", "", *(f"    {line}" for line in block))
        return
    for number, line in enumerate(block):
        item = _ITEM.match(line)
        if item and number:
            yield ""
        yield item[0] + _inline(line[item.end() :]) if item else _inline(line)


def _inline(text: str) -> str:
    parts, at = [], 0
    for code in _CODE.finditer(text):
        parts += [_SPECIAL.sub(r"\\\1", text[at : code.start()]), f"``{code[2].strip()}``\\ "]
        at = code.end()
    return "".join([*parts, _SPECIAL.sub(r"\\\1", text[at:])])
