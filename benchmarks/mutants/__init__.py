"""In: a copy of the repository. Out: which small errors, put into it one at a time, its tests
notice.
"""
