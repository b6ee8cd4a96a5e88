"""`python -m gaitway.compose` is deprecated: it is called `python -m gaitway.service.compose`."""

import sys

from gaitway.service.compose import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
