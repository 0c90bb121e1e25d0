"""Shapes of robots and obstacles in, signed distances out, by coal."""
