"""This stage describes values to people: one or two lines for `repr`, and pictures for notebooks.

The classes that it describes import it, so it cannot import them. It knows them only by the names
of their fields.
"""
