"""`python -m plotter`: the command line, for where the `plotter` script is not on the path."""

import sys

from plotter.cli.start import main

if __name__ == "__main__":
    main(sys.argv[1:])
