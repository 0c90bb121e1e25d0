"""Short dynamic runs with thrusters that fail, for the benchmark and the tests."""
