"""OpenCV's FileStorage in YAML, JSON and XML, as dicts, lists, numbers and words; and back.

A matrix (`!!opencv-matrix`) is a dict with `rows`, `cols`, `dt` and `data`, as in all three.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np

from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import StrPath
from jaxpoint.io.plain_yaml import parse_yaml

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


def parse_storage(path: StrPath, text: str) -> dict[str, Any]:
    """What stands in a FileStorage, whichever of the three it is.

    Raises:
        FileFormatError: it is none of them, or damaged.
    """
    start = text.lstrip()[:1]
    content = parse_json(path, text) if start == "{" else _xml(path, text) if start == "<" else parse_yaml(path, text)
    if not isinstance(content, dict):
        raise FileFormatError(f"{path} holds no named values; OpenCV's FileStorage has 'name: value'.")
    return content


def parse_json(path: StrPath, text: str) -> Any:
    """What stands in a JSON file.

    Raises:
        FileFormatError: it is not JSON.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: {error}; it is not JSON.") from None


def parse_xml(path: StrPath, text: str, what: str = "XML") -> ElementTree.Element:
    """The root of an XML file, which should be `what`.

    Raises:
        FileFormatError: it is not XML.
    """
    try:
        return ElementTree.fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text))
    except (ElementTree.ParseError, RecursionError, ValueError) as error:
        raise FileFormatError(f"{path}: {error}; it is not {what}.") from None


def _xml(path: StrPath, text: str) -> Any:
    root = parse_xml(path, text)
    if root.tag != "opencv_storage":
        raise FileFormatError(f"{path} is not OpenCV's XML: it begins with <{root.tag}>, not <opencv_storage>.")
    return {child.tag: _element(child) for child in root}


def _element(element: ElementTree.Element) -> Any:
    if len(element):
        if all(child.tag == "_" for child in element):
            return [_element(child) for child in element]
        value = {child.tag: _element(child) for child in element}
        if "data" in value and not isinstance(value["data"], list):
            value["data"] = [value["data"]]  # a matrix with one entry
        return value
    words = re.findall(r'"[^"]*"|\S+', element.text or "")
    values = [_word(word) for word in words]
    return values[0] if len(values) == 1 else values


def _word(word: str) -> Any:
    if word[0] == '"':
        return word[1:-1]
    return float(word) if _NUMBER.fullmatch(word) and not word.isdigit() else int(word) if word.isdigit() else word


def encode_storage(path: Path, values: Mapping[str, Any]) -> bytes:
    """A FileStorage as OpenCV itself writes it, of the kind that the name ends in: .xml, .json, else YAML 1.0.

    Args:
        values: names with numbers, words, lists of words, or arrays, which become matrices.
    """
    suffix = path.suffix.lower() if path.suffix.lower() in (".xml", ".json") else ".yml"
    storage = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, value in values.items():
        if isinstance(value, list):
            storage.startWriteStruct(name, cv2.FILE_NODE_SEQ)
            for word in value:
                storage.write("", word)
            storage.endWriteStruct()
        else:
            storage.write(name, np.asarray(value, float) if isinstance(value, np.ndarray) else value)
    text = storage.releaseAndGetString()
    return text.replace("%YAML 1.2\n", "%YAML:1.0\n", 1).encode()  # which all versions read
