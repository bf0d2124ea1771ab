"""`python -m scene_attack` is `scene-attack`."""

import sys


def main() -> None:
    """Runs the command line; Ctrl-C while its modules are imported ends it as it does later."""
    try:
        from scene_attack.cli.app import main as run

        run()
    except KeyboardInterrupt:
        print("scene-attack: interrupted", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
