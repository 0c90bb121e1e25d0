"""Descriptions of links in, Fossen's coefficients and wrenches out."""
