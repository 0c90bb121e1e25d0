"""Shapes of robots and obstacles in, signed distances out, in machine code or by coal."""
