"""What one view shows of people, whoever found it: the interface between detection and people in 3-D."""

from jaxpoint.lazy import exports

__getattr__, __dir__, __all__ = exports(__name__, __file__)
