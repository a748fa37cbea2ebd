"""People in 3-D: what single views show, put together to heads with ids, limbs and joints."""

from jaxpoint.lazy import exports

__getattr__, __dir__, __all__ = exports(__name__, __file__)
