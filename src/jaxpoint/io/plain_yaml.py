"""The YAML that calibration tools write: maps, lists, numbers and words, in blocks or in brackets.

OpenCV's `%YAML:1.0`, its `!!opencv-matrix`, lists that are not indented (Kalibr) and lists in brackets over several
lines are read alike. Anchors, aliases and text over several lines are refused.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import StrPath

MAX_DEPTH = 40  # of lists in lists; deeper ones are no calibration
_KEY = re.compile(r"""(?P<key>"[^"]*"|'[^']*'|[^\s"'\[\]{}#,&*!|>%@`:?-][^:#]*?)\s*:(?=\s|$)\s*""")
_TAG = re.compile(r"!!?[\w.:/-]*(?=\s|$)\s*")
_TOKEN = re.compile(r"""\s*(?:(?P<mark>[\[\]{},])|(?P<quoted>"(?:[^"\\]|\\.)*"|'[^']*')|(?P<plain>[^\[\]{},]+))""")
_WORDS = {"": None, "~": None, "null": None, "true": True, "false": False, ".nan": float("nan"), ".inf": float("inf")}
_INTEGER = re.compile(r"[+-]?\d{1,18}")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


@dataclass
class _Line:
    number: int
    indent: int
    text: str


def parse_yaml(path: StrPath, text: str) -> Any:
    """What stands in a YAML file, as dicts, lists, numbers, words, True, False and None.

    Raises:
        FileFormatError: it is no such YAML; the message names the line.
    """
    reader = _Reader(path, _lines(text))
    if not reader.lines:
        return None
    value = reader.block(reader.lines[0].indent, 0)
    if reader.at < len(reader.lines):
        raise reader.error("the indentation does not fit the lines before")
    return value


def _lines(text: str) -> list[_Line]:
    found = []
    for number, raw in enumerate(text.splitlines(), start=1):
        if raw.startswith("%") or re.fullmatch(r"(---|\.\.\.)\s*", raw):
            continue
        plain = _without_comment(raw.expandtabs(2)).rstrip()
        if plain.strip():
            found.append(_Line(number, len(plain) - len(plain.lstrip()), plain.strip()))
    return found


def _without_comment(line: str) -> str:
    if "#" not in line:
        return line
    quote = ""
    for i, character in enumerate(line):
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'" and (i == 0 or line[i - 1] in " [{,:-"):
            quote = character
        elif character == "#" and (i == 0 or line[i - 1].isspace()):
            return line[:i]
    return line


class _Reader:
    def __init__(self, path: StrPath, lines: list[_Line]):
        self.path, self.lines, self.at = path, lines, 0

    def error(self, why: str) -> FileFormatError:
        number = self.lines[min(self.at, len(self.lines) - 1)].number
        return FileFormatError(f"{self.path}, line {number}: this YAML cannot be read ({why}); mend that line.")

    def block(self, indent: int, depth: int) -> Any:
        """The value that begins at the present line, all of whose lines are indented so far."""
        if depth > MAX_DEPTH:
            raise self.error(f"more than {MAX_DEPTH} levels")
        text = self.lines[self.at].text
        if text == "-" or text.startswith("- "):
            return self._list(indent, depth)
        if _KEY.match(text):
            return self._map(indent, depth)
        line = self.lines[self.at]
        return self._value(line.text, indent, depth)

    def _here(self, indent: int) -> bool:
        return self.at < len(self.lines) and self.lines[self.at].indent == indent

    def _list(self, indent: int, depth: int) -> list[Any]:
        values = []
        while self._here(indent) and re.match(r"-(\s|$)", self.lines[self.at].text):
            line = self.lines[self.at]
            rest = line.text[1:].lstrip()
            rest = _TAG.sub("", rest, count=1) if rest.startswith("!") else rest
            if not rest:
                self.at += 1
                values.append(self._nested(indent, depth, lists_alike=False))
                continue
            inner = indent + len(line.text) - len(rest)
            self.lines[self.at] = _Line(line.number, inner, rest)
            values.append(self.block(inner, depth + 1))
        return values

    def _map(self, indent: int, depth: int) -> dict[str, Any]:
        values: dict[str, Any] = {}
        while self._here(indent):
            text = self.lines[self.at].text
            match = _KEY.match(text)
            if match is None:
                raise self.error("a key and a colon are expected")
            key = match["key"].strip("\"'")
            if key in values:
                raise self.error(f"'{key}' stands there twice")
            rest = text[match.end() :]
            rest = _TAG.sub("", rest, count=1) if rest.startswith("!") else rest
            if rest:
                values[key] = self._value(rest, indent, depth)
            else:
                self.at += 1
                values[key] = self._nested(indent, depth, lists_alike=True)
        return values

    def _nested(self, indent: int, depth: int, lists_alike: bool) -> Any:
        """What stands below a key or a dash; nothing where the next line is indented no further."""
        if self.at >= len(self.lines):
            return None
        line = self.lines[self.at]
        alike = lists_alike and line.indent == indent and re.match(r"-(\s|$)", line.text)
        return self.block(line.indent, depth + 1) if line.indent > indent or alike else None

    def _value(self, text: str, indent: int, depth: int) -> Any:
        """A value on the present line, in brackets perhaps over several."""
        if text[0] in "&*|>":
            raise self.error("anchors, aliases and text over several lines are not read")
        if text[0] not in "[{":
            self.at += 1
            return _scalar(text)
        parts, open_brackets = [text], _opened(text)
        while open_brackets > 0:
            self.at += 1
            if self.at >= len(self.lines):
                raise self.error("a bracket is not closed")
            parts.append(self.lines[self.at].text)
            open_brackets += _opened(parts[-1])
        text = " ".join(parts)
        value, end = self._flow(text, 0, depth)
        if text[end:].strip():
            raise self.error(f"'{text[end:].strip()[:20]}' stands after the bracket")
        self.at += 1
        return value

    def _flow(self, text: str, start: int, depth: int) -> tuple[Any, int]:
        """A list or map in brackets, and where it ends."""
        if depth > MAX_DEPTH:
            raise self.error(f"more than {MAX_DEPTH} levels")
        closing = "]" if text[start] == "[" else "}"
        items: list[tuple[str | None, Any]] = []
        key, value, filled, at = None, None, False, start + 1
        while match := _TOKEN.match(text, at):
            at = match.end()
            mark = match["mark"]
            if mark in ("[", "{"):
                value, at = self._flow(text, at - 1, depth + 1)
                filled = True
            elif mark in (",", closing):
                if filled or key is not None:
                    items.append((key, value))
                key, value, filled = None, None, False
                if mark == closing:
                    return self._collected(items, closing), at
            elif mark is not None:
                break
            else:
                key, value, filled = self._item(match[0].strip(), key, closing)
        raise self.error("a bracket is not closed")

    def _item(self, plain: str, key: str | None, closing: str) -> tuple[str | None, Any, bool]:
        if closing == "}" and key is None:
            name, colon, rest = plain.partition(":")
            if not colon:
                raise self.error(f"'{plain[:20]}' has no colon")
            return name.strip().strip("\"'"), _scalar(rest.strip()), bool(rest.strip())
        return key, _scalar(plain.lstrip(":").strip() if key is not None else plain), True

    def _collected(self, items: list[tuple[str | None, Any]], closing: str) -> Any:
        if closing == "]":
            return [value for _, value in items]
        return {str(key): value for key, value in items}


def _opened(text: str) -> int:
    """How many more brackets open than close."""
    return text.count("[") + text.count("{") - text.count("]") - text.count("}")


def _scalar(text: str) -> Any:
    if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'":
        inner = text[1:-1]
        return re.sub(r"\\(.)", r"\1", inner) if text[0] == '"' else inner.replace("''", "'")
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    if text.lower() == "-.inf":
        return -float("inf")
    if _INTEGER.fullmatch(text):
        return int(text)
    return float(text) if _NUMBER.fullmatch(text) else text
