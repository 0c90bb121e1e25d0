"""Identify the numbers of a vehicle from its own recordings.

Data flows one way: recordings (`reading`, `data_quality`) -> `parameters` (what may be identified, consistent whatever its value) ->
`model` (what the vehicle does with them, from the symbolic dynamics) -> `equation_error`, `output_error` (the fit) -> `uncertainty`,
`validation` (how sure, what is not determined) -> `results`. `experiment_design` goes the other way: from what is to be identified to
commands that show it.
"""
