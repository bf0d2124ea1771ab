"""The commands `python -m benchmarks.study record` and `python -m benchmarks.study page`; see --help."""

import argparse
from pathlib import Path

from benchmarks.study import __doc__ as about
from benchmarks.study import examples
from benchmarks.study.pages import FOLDER, NAMES, WITH_EXAMPLES, write
from benchmarks.study.record import save
from benchmarks.study.recording import of_folder
from scene_attack.runs.environment import options_to_run


def main() -> None:
    """Makes a record of a campaign that has been run, or the pages of all records."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.study", description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True, dest="command")
    record = commands.add_parser("record", help="make the record of a campaign that has been run")
    record.add_argument("folder", type=Path, help="the folder of `scene-attack campaign run`")
    record.add_argument("name", choices=NAMES, help="the name of the record")
    page = commands.add_parser("page", help="write the pages and their curves from the records")
    for command in (record, page):
        command.add_argument(
            "--study", type=Path, default=FOLDER, help="folder of records and page (default docs/study)"
        )
    options = parser.parse_args()
    if options.command == "page":
        for path in write(options.study):
            print(path)
        return
    options_to_run()  # a campaign may name what a plug-in brings
    study_record = of_folder(options.folder)
    save(study_record, options.study / f"{options.name}.json")
    if options.name in WITH_EXAMPLES:
        chosen = examples.of_record(study_record, options.name, options.folder, options.study)
        examples.save(options.study, options.name, chosen)


if __name__ == "__main__":
    main()
