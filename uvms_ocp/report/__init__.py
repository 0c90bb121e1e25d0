"""Metrics and reports of one run, read from its `Record` alone, of two runs side by side, and of
plans.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
