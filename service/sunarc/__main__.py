"""`python -m sunarc` runs the command line."""

from sunarc.cli.main import main

if __name__ == "__main__":
    main()
