"""From images to pixels: detectors on OpenCV and numpy."""

from jaxpoint.lazy import exports

__getattr__, __dir__, __all__ = exports(__name__, __file__)
