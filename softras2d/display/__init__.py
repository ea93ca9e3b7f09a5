"""This stage describes values to people: one or two lines for `repr`, pictures for notebooks.

It lies above the classes that it describes, so that each of them can call it. It therefore knows
them only by the names of their fields.
"""
