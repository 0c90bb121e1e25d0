"""Task-priority planning and optimal control of underwater vehicle-manipulator systems."""

__version__ = "0.1.0"
