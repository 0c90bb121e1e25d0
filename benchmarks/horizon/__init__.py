"""In: optimal control problems. Out: rows of what solvers make of them, ours and those of the
peers.
"""
