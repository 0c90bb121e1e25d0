"""The controller as files of C: no Python, no allocation, no input or output, libm only."""
