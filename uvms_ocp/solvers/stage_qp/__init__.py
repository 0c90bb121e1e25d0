"""Convex QPs of stages by an interior point around a Riccati recursion, in C; by PIQP without a
compiler.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
