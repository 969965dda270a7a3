"""python -m pointray: the command `pointray`."""

from .cli import main

main()
