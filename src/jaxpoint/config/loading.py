"""Settings from TOML files and back, strictly: an unknown key or a value out of range is an error with its path."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from functools import reduce
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import msgspec
import tomli_w

from jaxpoint.errors import UsageError
from jaxpoint.finite import not_finite

Settings = TypeVar("Settings")


def load_settings(path: Path, kind: type[Settings]) -> Settings:
    """Read a TOML file strictly into a dataclass; relative paths in it count from its folder.

    Raises:
        UsageError: the file is missing or is not TOML, a key is unknown, or a value has the wrong type or range;
            the message names the key by its path.
    """
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UsageError(f"There is no configuration file '{path}'; check --config.") from None
    except (OSError, ValueError) as error:  # what is not TOML or not UTF-8 is a ValueError
        raise UsageError(f"'{path}' cannot be read as TOML: {error}.") from None
    for key, known in _unknown_keys(raw, kind):
        near = get_close_matches(key.rpartition(".")[2], known, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"known here: {', '.join(known)}."
        raise UsageError(f"'{path}' has the unknown key '{key}'; {hint}")
    try:
        return _convert(raw, kind, path.parent)
    except UsageError as error:
        raise UsageError(f"In '{path}': {error}") from None


def check_settings(settings: Settings) -> Settings:
    """The settings, once every value of them has been held against its type and range.

    Raises:
        UsageError: a value is out of range; the message names it by its path.
    """
    return _convert(_plain(settings), type(settings), Path())


def to_toml(settings: Any) -> str:
    """Settings as the text of a configuration file that can stand anywhere: paths absolute, unset values left out."""
    return tomli_w.dumps(_plain(settings, lambda path: str(path.absolute())))


def _convert(raw: dict, kind: type[Settings], folder: Path) -> Settings:
    def as_path(_: type, value: Any) -> Path:
        if not isinstance(value, str):
            raise ValueError("expected a path in quotes")
        return folder / value

    for key, number in not_finite(raw):
        raise _setting_error(key, "expected a finite number", number)
    try:
        return msgspec.convert(raw, kind, dec_hook=as_path)
    except msgspec.ValidationError as error:
        reason, _, place = str(error).partition(" - at `$.")
        keys = place.rstrip("`").split(".")
        names = (key.partition("[")[0] for key in keys)  # of an item of a list the whole list is shown
        given = reduce(lambda table, name: table.get(name) if isinstance(table, dict) else None, names, raw)
        raise _setting_error(".".join(keys), reason, given) from None


def _setting_error(key: str, reason: str, given: Any) -> UsageError:
    """The error of one setting; what was given is shown where it is a value."""
    shown = "" if given is None or isinstance(given, dict) else f" (given: {given!r})"
    return UsageError(f"The setting '{key.removeprefix('settings.')}' cannot be used: {reason}{shown}.")


def _unknown_keys(raw: Any, kind: Any, place: str = "") -> Iterator[tuple[str, list[str]]]:
    """Keys of `raw` that the dataclass does not have (as dotted paths), with the keys it knows there."""
    if isinstance(raw, list) and get_origin(kind) is tuple:
        for i, item in enumerate(raw):
            yield from _unknown_keys(item, get_args(kind)[0], f"{place.removesuffix('.')}[{i}].")
    elif isinstance(raw, dict) and is_dataclass(kind):
        types = get_type_hints(kind)
        for key, value in raw.items():
            if key in types:
                yield from _unknown_keys(value, types[key], f"{place}{key}.")
            else:
                yield place + key, list(types)


def _plain(value: Any, path_text: Callable[[Path], str] = str) -> Any:
    """Settings as nested dictionaries of TOML's own types, without what is None."""
    if is_dataclass(value) and not isinstance(value, type):
        value = {item.name: getattr(value, item.name) for item in fields(value)}
    if isinstance(value, dict):
        return {key: _plain(item, path_text) for key, item in value.items() if item is not None}
    if isinstance(value, (tuple, list)):
        return [_plain(item, path_text) for item in value]
    return path_text(value) if isinstance(value, Path) else value
