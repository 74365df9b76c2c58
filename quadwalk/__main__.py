"""`python -m quadwalk`, and the console command `quadwalk`."""

from quadwalk.cli.main import main

if __name__ == "__main__":
    main()
