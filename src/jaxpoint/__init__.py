"""Calibrate a room of cameras from a waved light, and say what a person points at.

The public names load on first use, so that `import jaxpoint` and `jaxpoint --help` stay quick; `__init__.pyi` lists
them. What a subpackage offers beyond them can be imported from that subpackage.
"""

from jaxpoint.lazy import exports

__getattr__, __dir__, __all__ = exports(__name__, __file__)
