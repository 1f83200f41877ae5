"""The command line by `python -m rlgcomp`."""

from rlgcomp.cli import main

if __name__ == "__main__":
    main()
