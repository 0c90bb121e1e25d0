"""Studies that judge the toolkit: many cases each, and a table that sums them up."""
