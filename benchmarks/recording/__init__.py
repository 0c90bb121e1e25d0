"""In: rows of figures. Out: a CSV file and a Markdown file with one head, which says how, where and
how undisturbed.
"""
