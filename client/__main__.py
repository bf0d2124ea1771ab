"""`python -m client` is `scene-attack`."""

from client.cli import main

if __name__ == "__main__":
    main()
