"""API pages show the fields of a class as one table, with the comments that give their units and shapes.

In the source a field is one line with a comment behind it, `pixels: Float[Array, "F C 2"]  # px`; mkdocstrings reads
docstrings only, and would give every field a heading of its own.
"""

from __future__ import annotations

import re
from typing import Any

import griffe

_COMMENT = re.compile(r"\s#\s(.+)$")


class FieldTables(griffe.Extension):
    """Moves the fields of every class into a section `Attributes` of its docstring."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Called by griffe when all is read and dataclasses have their signatures."""
        _walk(pkg)


def _walk(scope: griffe.Module | griffe.Class) -> None:
    for member in list(scope.members.values()):
        if member.is_alias or not (member.is_module or member.is_class):
            continue
        if member.is_class:
            _tabulate(member)
        _walk(member)


def _tabulate(cls: griffe.Class) -> None:
    fields = [member for member in cls.members.values() if _is_field(member)]
    if not fields:
        return
    text = cls.docstring.value if cls.docstring else ""
    rows = "\n".join(f"    {_row(field)}" for field in fields)
    cls.docstring = griffe.Docstring(f"{text}\n\nAttributes:\n{rows}", parent=cls)
    for field in fields:
        del cls.members[field.name]


def _is_field(member: griffe.Object | griffe.Alias) -> bool:
    """Of the class itself, neither inherited nor a property."""
    own = member.is_attribute and not member.is_alias and "property" not in member.labels
    return own and not member.name.startswith("_")


def _row(field: griffe.Attribute) -> str:
    kind = f" ({field.annotation})" if field.annotation else ""
    meaning = " ".join(field.docstring.value.split()) if field.docstring else _comment(field)
    return f"{field.name}{kind}: {meaning}{_default(field)}"


def _default(field: griffe.Attribute) -> str:
    """Of a setting; not the values of enumerations, nor what a factory makes."""
    shown = field.annotation and field.value and "field(" not in str(field.value)
    return f" Default: `{field.value}`." if shown else ""


def _comment(field: griffe.Attribute) -> str:
    """Behind the field's last line."""
    found = _COMMENT.search(field.lines[-1]) if field.lines else None
    return f"{found[1].rstrip('.')}." if found else ""
