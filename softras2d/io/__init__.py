"""This stage reads and writes pictures, films and drawings."""
