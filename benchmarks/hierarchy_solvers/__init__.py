"""In: problems of several levels. Out: what each solver makes of them, how long it takes, how far
it is from the best.
"""
