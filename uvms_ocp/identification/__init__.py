"""Identify the numbers of a vehicle from its own recordings.

Data flows one way: recordings (`reading`, `data_quality`) -> `parameters` (physically consistent at any value) -> `model` (one
step of the vehicle, from the symbolic dynamics) -> `equation_error`, `output_error` (the fit) -> `uncertainty`, `validation` ->
`results`. `experiment_design` goes the other way: from numbers to be identified to commands that excite them.
"""
