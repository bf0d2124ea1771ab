"""Tests whether the torch renderer's estimates hold during attacks. Writes results/attack_bounds.json.

60 random odd scenes, and 16 chosen to break the estimates, are attacked for 120 steps; every image is compared with the
exact renderer's. A run that was stopped is resumed by the same command; remove its file if the code has changed.
"""

import argparse
import json
import platform
from pathlib import Path

import torch
from rich.progress import track

from client.settings import settings_to_run
from services.accuracy.attack_errors import AttackErrors, adversarial_scenes, attack_errors, random_scenes
from services.accuracy.provenance import PACKAGES, backend
from services.process import versions
from services.scenes.library import Library

HERE = Path(__file__).parent


def main() -> None:
    """Runs the attacks; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--random", type=int, default=60, help="random scenes (default 60)")
    parser.add_argument("--seed", type=int, default=0, help="of the random scenes (default 0)")
    parser.add_argument("--threads", type=int, default=2, help="of torch (default 2)")
    parser.add_argument("--out", type=Path, default=HERE / "results" / "attack_bounds.json")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    given = f"--random {options.random} --seed {options.seed} --threads {options.threads}"
    cases = [*adversarial_scenes(), *random_scenes(options.random, options.seed)]
    made_by = {
        "command": f"python -m benchmarks.attack_bounds {given}",
        "machine": platform.platform(),
        "versions": versions(*PACKAGES),
        "backend": backend(),
        "seed": options.seed,
    }
    found = _earlier(options.out, made_by)
    settings = settings_to_run()
    library = Library(settings.cache_dir, settings.data_dir)
    for case in track([case for case in cases if case.name not in found], "attacking"):
        row = found[case.name] = attack_errors(case, library)
        _write(options.out, made_by, list(found.values()), len(cases))
        print(
            f"{row.name}: {case.scene.objects[0].mesh}, {' '.join(row.groups)}, tolerance {row.tolerance:g}: "
            f"worst {row.worst:.1e} of {row.estimate:.1e}, {row.failed_checks} checks failed, {row.beyond} beyond"
        )


def _earlier(path: Path, made_by: dict[str, object]) -> dict[str, AttackErrors]:
    """The rows of an earlier run of the same command by the same versions, or an empty list if there is none."""
    if not path.exists():
        return {}
    report = json.loads(path.read_text("utf-8"))
    if {name: report.get(name) for name in made_by} != made_by:
        return {}
    return {row["name"]: AttackErrors.model_validate(row) for row in report["rows"]}


def _write(path: Path, made_by: dict[str, object], rows: list[AttackErrors], planned: int) -> None:
    summary = {
        "scenes": len(rows),
        "scenes_planned": planned,
        "scenes_with_tables": sum(row.table for row in rows),
        "images": sum(row.images for row in rows),
        "images_beyond_estimate": sum(row.beyond for row in rows),
        "images_of_failed_checks": sum(row.failed_checks for row in rows),
        "largest_share_of_estimate": max(row.worst / row.estimate for row in rows),
    }
    report = made_by | {"summary": summary, "rows": [row.model_dump(mode="json") for row in rows]}
    part = path.with_suffix(".part")
    part.write_text(json.dumps(report, indent=1) + "\n", "utf-8")
    part.replace(path)


if __name__ == "__main__":
    main()
