"""`python -m softras2d` is the command `softras2d`."""

from .cli import main

if __name__ == "__main__":
    main()
