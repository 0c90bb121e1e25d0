"""Shapes of robots and obstacles, and signed distances between them, in machine code or by coal."""
