"""Task-priority planning and optimal control of underwater vehicle-manipulator systems."""
