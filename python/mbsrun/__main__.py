"""`python -m mbsrun` is `mbsrun`."""

from mbsrun.cli import main

if __name__ == "__main__":
    main()
