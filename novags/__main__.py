"""`python -m novags` is `novags`."""

from novags.cli import main

main()
