"""python -m pointray.cli"""

from . import main

main()
